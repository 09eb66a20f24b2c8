// A page that is opened as a file may not start a worker: run the worker's script in a hidden frame instead.
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(address) {
      super();
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      document.body.appendChild(this.frame);
      const inside = this.frame.contentWindow;
      inside.document.open();
      inside.document.write("<!doctype html><body></body>");
      inside.document.close();
      const run = (source) => new Promise((done, failed) => {
        const script = inside.document.createElement("script");
        Object.assign(script, {src: source, onload: done, onerror: failed});
        inside.document.body.appendChild(script);
      });
      inside.importScripts = (...sources) => sources.reduce((before, source) => before.then(() => run(source)), Promise.resolve());
      inside.postMessage = (data) => {
        const event = new MessageEvent("message", {data: structuredClone(data)});
        this.dispatchEvent(event);
        if (this.onmessage) this.onmessage(event);
      };
      this.started = run(address);
    }
    postMessage(data) {
      const inside = this.frame.contentWindow;
      this.started.then(() => inside.dispatchEvent(new inside.MessageEvent("message", {data: structuredClone(data)})));
    }
    terminate() {
      this.frame.remove();
    }
  };
}
