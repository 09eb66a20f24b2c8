// Requests to the server of a page over a WebSocket. `lost` is called when the connection ends; unanswered requests are dropped then.
const askingIn = (lost) => {
  let socket = null, number = 0, ended = false;
  const waiting = new Map(), at = location.href.split(/[?#]/)[0].replace(/^http/, "ws").replace(/\/$/, "") + "/timeline";
  // The length of a head in 4 bytes, the head as JSON, and float32.
  const unpack = (buffer) => {
    const size = new DataView(buffer).getUint32(0, true);
    const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, size)));
    return { ...head, floats: new Float32Array(buffer, 4 + size) };
  };
  const say = (wish) => {
    if (socket?.readyState === 1) { socket.send(JSON.stringify(wish)); return; }
    if (!socket || socket.readyState > 1) {
      socket = new WebSocket(at);
      socket.binaryType = "arraybuffer";
      socket.onmessage = (event) => { const found = unpack(event.data); waiting.get(found.number)?.(found); waiting.delete(found.number); };
      socket.onclose = () => { waiting.clear(); if (!ended) lost(); };
    }
    socket.addEventListener("open", () => socket.send(JSON.stringify(wish)), { once: true });
  };
  return {
    say,
    // Resolves to the head of the answer, with its numbers as `floats`.
    request: (wish) => {
      wish.number = ++number;
      return new Promise((done) => { waiting.set(wish.number, done); say(wish); });
    },
    ends: () => { ended = true; socket?.close(); },
  };
};
