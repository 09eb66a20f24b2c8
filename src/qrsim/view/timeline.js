// The timeline of a replay: over the full width, with marks of events; keys. Its data stands before it as `data`.
(() => {
  document.getElementById("qrsim-timeline")?.remove();
  window.qrsimTimelineEnds?.();
  const bar = document.createElement("div");
  bar.id = "qrsim-timeline";
  bar.style.cssText = "position:fixed;left:0;right:0;bottom:0;height:34px;z-index:50;background:rgba(250,250,250,.92);" +
    "font:12px sans-serif;color:#222;display:flex;align-items:center;gap:8px;padding:0 10px;box-sizing:border-box;" +
    "border-top:1px solid #bbb;touch-action:none;user-select:none";
  const button = document.createElement("button"), label = document.createElement("span");
  label.title = "click to type a time, in seconds or minutes:seconds";
  const track = document.createElement("div"), done = document.createElement("div");
  button.style.cssText = "border:0;background:none;font:16px sans-serif;width:26px;cursor:pointer;color:inherit";
  button.title = "play or pause (space)";
  label.style.cssText = "min-width:120px;text-align:right;white-space:nowrap;cursor:text;font-variant-numeric:tabular-nums";
  track.style.cssText = "position:relative;flex:1;height:18px;background:#d5d9de;cursor:pointer;border-radius:3px";
  done.style.cssText = "position:absolute;left:0;top:0;bottom:0;width:0;background:#7d8fa3;border-radius:3px";
  track.append(done);
  for (const [time, text] of data.marks) {
    const mark = document.createElement("div");
    mark.className = "qrsim-mark";
    mark.title = text;
    mark.style.cssText = "position:absolute;top:-4px;bottom:-4px;width:3px;margin-left:-1px;background:#222;left:" +
      100 * time / Math.max(data.end, 1e-9) + "%";
    track.append(mark);
  }
  const plots = document.createElement("button");
  plots.style.cssText = "border:1px solid #8888;border-radius:4px;background:none;font:inherit;cursor:pointer;color:inherit";
  plots.textContent = innerWidth < 600 ? "Plots" : "Highlights, plots, events";
  plots.title = "highlights, events, and quantities over time (P)";
  plots.onclick = () => { window.qrsimPlots?.toggle(); plots.blur(); };
  bar.append(button, track, label, plots);
  document.body.append(bar);
  const at = location.href.split(/[?#]/)[0].replace(/^http/, "ws").replace(/\/$/, "") + "/timeline";
  let socket = null, ended = false, playing = false, now = 0, last = 0, later = 0;
  // A page without a server plays by itself (film.js).
  const film = window.qrsimFilm;
  const connect = () => {
    if (ended || film) return;
    socket = new WebSocket(at);
    socket.onopen = () => { if (waiting) say(waiting); };
    socket.onclose = () => setTimeout(connect, 1000);
  };
  // The last wish waits for a connection.
  let waiting = null;
  const say = (wish) => {
    // The next key counts from here, even before the page has gone there.
    if ("time" in wish) now = wish.time = Math.min(data.end, Math.max(0, wish.time));
    if (film) { film.wish(wish); return; }
    waiting = socket?.readyState === 1 ? null : wish;
    if (!waiting) socket.send(JSON.stringify(wish));
  };
  connect();
  // Hours, minutes, and seconds to the nearest hundredth, as elsewhere on the page.
  const clock = (t) => {
    const hundredths = Math.round(100 * Number(t.toFixed(2))), whole = Math.floor(hundredths / 100), two = (n) => String(n).padStart(2, "0");
    const rest = two(Math.floor(whole / 60) % 60) + ":" + two(whole % 60) + "." + two(hundredths % 100);
    return data.end >= 3600 ? Math.floor(whole / 3600) + ":" + rest : rest;
  };
  window.qrsimTime = (time, plays, speed) => {
    now = time; playing = plays;
    window.qrsimPlots?.time(time);
    done.style.width = 100 * time / Math.max(data.end, 1e-9) + "%";
    const sign = plays ? "||" : "\u25B6";
    if (button.textContent !== sign) button.textContent = sign;
    label.textContent = clock(time) + " / " + clock(data.end) + "  " + speed + " x";
  };
  // Seconds, or parts with colons; NaN for anything else.
  const typed = (text) => /^\s*(\d+:){0,2}\d+([.,]\d*)?\s*s?\s*$/.test(text)
    ? text.replace(",", ".").split(":").reduce((sum, part) => 60 * sum + parseFloat(part), 0) : NaN;
  label.onclick = () => {
    const input = document.createElement("input");
    input.id = "qrsim-go-to";
    input.style.cssText = "width:100px;font:inherit;text-align:right";
    input.value = now.toFixed(2);
    const close = () => { input.onblur = null; input.replaceWith(label); };
    input.onblur = close;
    input.onkeydown = (event) => {
      if (event.key === "Escape") close();
      if (event.key !== "Enter") return;
      const time = typed(input.value);
      // What is no time stays to be mended.
      if (Number.isFinite(time)) { close(); go(time); } else input.style.color = "#c5130c";
    };
    label.replaceWith(input);
    input.select();
  };
  const seek = (event, always) => {
    clearTimeout(later);
    const wait = always ? 0 : 40 - (performance.now() - last), clientX = event.clientX;
    // Not too often, but the last place is never left out.
    if (wait > 0) { later = setTimeout(() => seek({clientX}, false), wait); return; }
    last = performance.now();
    const box = track.getBoundingClientRect();
    // While it is dragged, what is slow to draw may wait.
    say({time: data.end * Math.min(1, Math.max(0, (event.clientX - box.left) / box.width)), drag: !always});
  };
  track.onpointerdown = (event) => { track.setPointerCapture(event.pointerId); seek(event, true); };
  track.onpointermove = (event) => { if (event.buttons) seek(event, false); };
  track.onpointerup = (event) => seek(event, true);
  button.onclick = () => { say({play: !playing}); button.blur(); };
  // The next key goes on from there, before the server has said that it is there.
  const go = (time) => { now = Math.min(data.end, Math.max(0, time)); say({time: now}); };
  const key = (event) => {
    const typing = event.target.closest?.("input, textarea, select, [contenteditable]");
    if (typing || event.ctrlKey || event.altKey || event.metaKey) return;
    const far = event.shiftKey ? 60 : 5;
    if (event.key === " ") say({play: !playing});
    else if (event.key === "ArrowLeft") go(now - far);
    else if (event.key === "ArrowRight") go(now + far);
    else if (event.key === "ArrowUp") say({faster: 1});
    else if (event.key === "ArrowDown") say({faster: -1});
    else if (/^[1-9]$/.test(event.key)) go(data.end * Number(event.key) / 10);
    else return;
    event.preventDefault();
    event.stopImmediatePropagation();
  };
  // A number that is clicked in viser's panel is typed in place of the old one.
  const focus = ({ target }) => {
    if (!target.matches?.(".mantine-NumberInput-input")) return;
    target.select();
    target.addEventListener("mouseup", () => target.select(), { once: true });
    target.onkeyup = (event) => { if (event.key === "Enter") target.blur(); };
  };
  window.addEventListener("focusin", focus);
  window.addEventListener("keydown", key, true);
  window.qrsimTimelineEnds = () => {
    ended = true; socket?.close(); bar.remove(); window.removeEventListener("keydown", key, true); window.removeEventListener("focusin", focus);
  };
})();
