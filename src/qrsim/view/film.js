// A recorded run in a page of its own: unpacks the parts of the film, shows any time of it, and has a small panel.
(() => {
  const element = (name) => document.getElementById("qrsim-" + name);
  const about = JSON.parse(element("about").textContent);
  const kinds = {"<f4": Float32Array, "<f8": Float64Array, "|u1": Uint8Array, "<u2": Uint16Array, "<u4": Uint32Array,
    "|i1": Int8Array, "<i2": Int16Array, "<i4": Int32Array, "<f2": Uint16Array};

  // ---- what is packed in the page ----
  const unpacked = async (name) => {
    const text = element(name).textContent;
    const bytes = Uint8Array.fromBase64?.(text) ?? Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
    const buffer = await new Response(stream).arrayBuffer();
    const size = Number(new DataView(buffer).getBigUint64(0, true));
    const {content, lengths} = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 8, size)));
    let at = 8 + size + (-size & 7);
    const places = lengths.map((length) => { const place = [at, length]; at += length + (-length & 7); return place; });
    const revived = (value) => {
      if (value === null || typeof value !== "object") return value;
      if ("__binary_index" in value) {
        const [begin, length] = places[value.__binary_index], kind = kinds[value.dtype];
        return new kind(buffer, begin, length / kind.BYTES_PER_ELEMENT);
      }
      for (const key of Object.keys(value)) value[key] = revived(value[key]);
      return value;
    };
    return revived(content);
  };
  const kept = new Map();
  const part = (number) => {
    const found = kept.get(number) ?? unpacked("part-" + number);
    kept.delete(number);
    kept.set(number, found);
    if (kept.size > 3) kept.delete(kept.keys().next().value);
    return found;
  };

  // ---- the scene ----
  const viewer = () => window.__viserMutable;
  const roots = new Set(about.layers.map((layer) => layer.path));
  const send = (messages) => {
    for (const message of messages) viewer().messageQueue.push(message);
    if (document.hidden) viewer().drainMessageQueue?.();
    viewer().requestRender();
  };
  // What the panel decides itself.
  const ours = (message) => message.type === "SetSceneNodeVisibilityMessage" && roots.has(message.name);
  // Of each node that is there: the number of what made it, and what of it has changed since.
  const there = new Map();
  let nodes = [];
  const named = (message) => message.updates ? Object.keys(message.updates) : [message.type];
  // Merges what is said of one node, so that a jump says everything once.
  const batch = () => {
    const found = [], last = new Map();
    const add = (item) => {
      if (typeof item === "number") {
        const message = nodes[item];
        there.set(message.name, {made: item, changed: new Set()});
        for (const key of last.keys()) if (key.startsWith(message.name + "\n")) last.delete(key);
        found.push(message);
      } else if (item.type === "RemoveSceneNodeMessage") {
        there.delete(item.name);
        found.push(item);
      } else if (!ours(item)) {
        for (const name of named(item)) there.get(item.name)?.changed.add(name);
        const key = item.name + "\n" + item.type, before = last.get(key);
        if (before === undefined) {
          last.set(key, found.length);
          found.push(item);
        } else found[before] = item.updates ? {...item, updates: {...found[before].updates, ...item.updates}} : item;
      }
    };
    return {found, add};
  };
  const restore = (key, add) => {
    const made = new Map(), said = new Map();
    for (const item of key) {
      if (typeof item === "number") made.set(nodes[item].name, item);
      else for (const name of named(item)) said.set(item.name + "\n" + name, true);
    }
    for (const name of [...there.keys()]) if (!made.has(name)) add({type: "RemoveSceneNodeMessage", name, owner: ""});
    for (const [name, number] of made) {
      const now = there.get(name);
      // A property that this time does not know of yet has to be what it was at first.
      const stale = now && [...now.changed].some((property) => !said.has(name + "\n" + property));
      if (now?.made !== number || stale) add(number);
    }
    for (const item of key) if (typeof item !== "number") add(item);
  };

  // ---- time ----
  const state = {time: 0, playing: false, speed: 1, chosen: -1, follow: false, part: -1, frame: -1, position: null};
  const speeds = [0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50];
  const lastUpTo = (values, time) => {
    let low = 0, high = values.length;
    while (low < high) { const middle = (low + high) >> 1; if (values[middle] <= time + 1e-6) low = middle + 1; else high = middle; }
    return Math.max(0, low - 1);
  };
  let busy = false, again = false;
  const show = async () => {
    if (busy) { again = true; return; }
    busy = true;
    do {
      again = false;
      const frame = lastUpTo(about.times, state.time), number = lastUpTo(about.first, frame), first = about.first[number];
      const {frames, positions} = await part(number);
      const {found, add} = batch();
      if (state.part !== number || frame < state.frame) { restore(frames[0][1], add); state.frame = first; }
      for (let i = state.frame + 1; i <= frame; i++) for (const item of frames[i - first][1]) add(item);
      const count = about.vehicles.length;
      state.position = positions.subarray((frame - first) * count * 3, (frame - first + 1) * count * 3);
      Object.assign(state, {part: number, frame});
      send(found);
      if (frame - first > 0.8 * frames.length && number + 1 < about.first.length) part(number + 1);
    } while (again);
    busy = false;
    say();
  };
  // The ring round who is chosen, and the camera that goes with it (overlay.js).
  const mark = () => {
    const vehicle = state.chosen < 0 ? null : state.chosen;
    window.qrsim?.choose(vehicle);
    window.qrsim?.follow(state.follow ? vehicle : null);
  };
  const go = (time) => { state.time = Math.min(about.end, Math.max(0, time)); return show(); };
  const play = (on) => {
    if (on && state.time >= about.end) state.time = 0;
    state.playing = on;
    say();
  };
  window.qrsimFilm = {
    state, show, lines: (wish) => lines(wish),
    table: async () => state.position && details.table(about.times[Math.max(0, state.frame)], state.position, valuesOf),
    choose: (vehicle) => { who.value = (vehicle ?? -1) + 1; choose(vehicle ?? -1); },
    wish: (wish) => {
      if ("time" in wish) go(wish.time);
      if ("play" in wish) play(wish.play);
      if ("faster" in wish) {
        const at = speeds.indexOf(state.speed) + wish.faster;
        state.speed = speeds[Math.min(speeds.length - 1, Math.max(0, at))];
        say();
      }
    },
  };
  let before = performance.now();
  const tick = (now) => {
    const passed = Math.min(0.25, (now - before) / 1000);
    before = now;
    if (state.playing && !busy) {
      const time = state.time + passed * state.speed;
      if (time >= about.end) state.playing = false;
      go(time);
    }
    requestAnimationFrame(tick);
  };

  // ---- the panel ----
  const make = (kind, parent, text, style) => {
    const found = document.createElement(kind);
    found.textContent = text ?? "";
    found.style.cssText = style ?? "";
    parent.append(found);
    return found;
  };
  const panel = make("div", document.body, "", `position:fixed;right:8px;top:${innerWidth > 600 ? 8 : 46}px;width:280px;` +
    "max-width:calc(100vw - 16px);" +
    "max-height:calc(100vh - 60px);overflow:auto;z-index:40;background:rgba(250,250,250,.94);color:#222;padding:8px 10px;" +
    "box-sizing:border-box;border:1px solid #bbb;border-radius:4px;font:13px sans-serif");
  panel.id = "qrsim-panel";
  // The button of viser's own list of nodes is where the panel is.
  make("style", document.head, '.mantine-Paper-root:has(> [aria-label$="scene tree"]) {display: none !important}');
  const whole = make("details", panel);
  whole.open = innerWidth > 600;
  make("summary", whole, about.heading, "font-weight:bold;cursor:pointer;overflow-wrap:anywhere");
  const status = make("div", whole, "", "margin:4px 0;white-space:pre-line");
  for (const note of about.notes) make("div", whole, note, "color:#666");
  const choice = (parent, label, names, chosen, change) => {
    const row = make("label", parent, label + " ", "display:block;margin:4px 0"), box = make("select", row, "", "max-width:170px");
    names.forEach((name, number) => { make("option", box, name).value = number; });
    box.value = chosen;
    box.onchange = () => { change(Number(box.value)); box.blur(); };
    return box;
  };
  const tick_box = (parent, label, on, change) => {
    const row = make("label", parent, "", "display:block;cursor:pointer"), box = make("input", row);
    box.type = "checkbox";
    box.checked = on;
    row.append(" " + label);
    box.onchange = () => { change(box.checked); box.blur(); };
  };
  const who = choice(whole, "Vehicle", ["(nobody)", ...about.vehicles], 0, (number) => choose(number - 1));
  who.id = "qrsim-vehicle";
  tick_box(whole, "Follow", false, (on) => {
    state.follow = on;
    mark();
  });
  const layers = make("details", whole);
  make("summary", layers, "Layers", "cursor:pointer");
  for (const layer of about.layers) tick_box(layers, layer.title, layer.shown, (on) => visible(layer, on));
  const visible = (layer, on) => send([{type: "SetSceneNodeVisibilityMessage", name: layer.path, visible: on, owner: ""}]);

  const details = detailsIn({
    about, send, lastUpTo, made: (path) => nodes[there.get(path)?.made],
    place: (vehicle) => state.position?.subarray(3 * vehicle, 3 * vehicle + 3),
  });
  let sky = null;
  const choose = async (vehicle) => {
    state.chosen = vehicle;
    sky = about.sky.times.length && element("sky-" + vehicle) ? await unpacked("sky-" + vehicle) : null;
    details.choose(vehicle < 0 ? null : await valuesOf(vehicle));
    mark();
    drawSky();
  };
  // The sky over it (sky.js), where its receiver says anything of its satellites.
  let shownSky = "";
  const drawSky = () => {
    const times = about.sky.times, row = sky ? lastUpTo(times, state.time) : -1, key = state.chosen + " " + row;
    const satellites = [];
    for (let at = row; sky && at < sky.satellite.length; at += times.length) {
      if (sky.satellite[at] < 0 || sky.elevation[at] < 0) continue;
      satellites.push([about.sky.names[sky.satellite[at]], sky.azimuth[at], sky.elevation[at], sky.cn0[at], sky.satellite_state[at]]);
    }
    details.show(state.chosen, state.time, satellites);
    if (key === shownSky) return;
    shownSky = key;
    window.qrsim?.sky(satellites.length ? {vehicle: about.vehicles[state.chosen], satellites} : null);
  };
  // ---- lines of plots (plots.js) ----
  const numbers = new Map(about.quantities.map((name, row) => [name, row])), values = new Map();
  const valuesOf = (vehicle) => {
    if (!values.has(vehicle)) values.set(vehicle, unpacked("plots-" + vehicle));
    return values.get(vehicle);
  };
  const lines = async ({number, lines, from, to, bins}) => {
    const count = Math.min(2000, Math.max(10, bins)), step = (to - from) / count, period = about.period, parts = [];
    const times = Float32Array.from({length: 2 * count}, (_, i) => from + step * (i >> 1) + (i & 1 ? 0.5 * step : 0));
    const row = (found, name) => {
      const size = found.values.length / about.quantities.length, at = numbers.get(name) * size;
      return found.values.subarray(at, at + size);
    };
    // Two values a bin, as of the server (plots.py): its extremes in their order, or where it has fewer, the last.
    const binned = (own) => Float32Array.from(times, (time, i) => {
      const at = (t) => Math.min(own.length - 1, Math.max(0, Math.floor(t / period + 1e-6)));
      if (step <= 2 * period) return own[at(time)];
      const first = at(times[i - (i & 1)]), last = Math.max(first + 1, at(times[i - (i & 1)] + step));
      let low = first, high = first;
      for (let k = first; k < last; k++) { if (!(own[k] >= own[low])) low = k; if (!(own[k] <= own[high])) high = k; }
      return own[(i & 1) === (low < high ? 0 : 1) ? low : high];
    });
    // Distances to one vehicle are too many to be stored, so they are computed here.
    const PLACE = ["x", "y", "z"].map((axis) => "truth.position_ned." + axis), TO = "derived.distance_to.";
    const distances = async (found, name, vehicle) => {
      const wanted = name.slice(TO.length), names = [wanted, about.vehicles[vehicle].slice(0, 2) + wanted];
      const other = about.vehicles.findIndex((each) => names.includes(each));
      if (other < 0 || other === vehicle || !PLACE.every((each) => numbers.has(each))) return null;
      const [mine, theirs] = [found, await valuesOf(other)].map((of) => PLACE.map((each) => row(of, each)));
      return mine[0].map((_, k) => Math.hypot(...mine.map((axis, i) => axis[k] - theirs[i][k])));
    };
    const heads = [];
    for (const [name, vehicle] of lines) {
      const found = await valuesOf(vehicle);
      const own = numbers.has(name) ? row(found, name) : name.startsWith(TO) ? await distances(found, name, vehicle) : null;
      if (!own) { heads.push(null); continue; }
      const head = {low: null, high: null, lowAt: null, highAt: null, band: false};
      for (let k = Math.max(0, Math.ceil(from / period - 1e-6)); k < own.length && k * period <= to + 1e-6; k++) {
        if (!Number.isFinite(own[k])) continue;
        if (head.low === null || own[k] < head.low) Object.assign(head, {low: own[k], lowAt: k * period});
        if (head.high === null || own[k] > head.high) Object.assign(head, {high: own[k], highAt: k * period});
      }
      if (head.low === null) { heads.push(null); continue; }
      parts.push(binned(own));
      const std = name.replace("commands.estimate.", "commands.estimate_std.");
      if (std !== name && numbers.has(std)) {
        head.band = true;
        const wide = row(found, std);
        for (const side of [-about.band, about.band]) parts.push(binned(own.map((value, k) => value + side * wide[k])));
      }
      heads.push(head);
    }
    const floats = new Float32Array(2 * count * (parts.length + 1));
    [times, ...parts].forEach((part, i) => floats.set(part, 2 * count * i));
    return {number, lines: heads, floats};
  };

  const say = () => {
    const time = about.times[Math.max(0, state.frame)], stopped = about.stops.filter((stop) => stop[0] <= time + 1e-6);
    const flying = about.flying[lastUpTo(about.flying.map((pair) => pair[0]), time)][1];
    const lines = [`t = ${time.toFixed(2)} s${state.playing ? "" : " (paused)"}`,
      `${flying} of ${about.fliers} vehicles fly${stopped.length ? `, ${stopped.length} stopped` : ""}${about.others ? `, ${about.others}` : ""}`,
      ...stopped.slice(0, 10).map((stop) => `${about.vehicles[stop[1]]}: ${stop[2]}`)];
    if (stopped.length > 10) lines.push(`and ${stopped.length - 10} more`);
    status.textContent = lines.join("\n");
    window.qrsim?.reasons(Object.fromEntries(stopped.slice(-20).map((stop) => [stop[1], stop[2]])));
    window.qrsimTime?.(time, state.playing, state.speed);
    drawSky();
  };

  // ---- the begin: once viser shows the first frame ----
  const begin = async () => {
    if (!(viewer() && window.__viserSceneTree?.getState()["/world"])) { setTimeout(begin, 50); return; }
    nodes = await unpacked("nodes");
    for (const layer of about.layers) if (!layer.shown) visible(layer, false);
    // What viser has shown so far, the first part makes anew where it has changed.
    await go(0);
    window.qrsimFilm.ready = true;
    requestAnimationFrame(tick);
  };
  begin();
})();
