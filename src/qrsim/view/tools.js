// Tools of each browser: camera presets and saved views, the place under the pointer, and measuring. `host` is the overlay.
const toolsIn = (host) => {
  const { data, state, make, tools } = host;
  const vector = (...parts) => new (host.m().camera.position.constructor)(...parts);
  const nedOf = (point) => point.clone().applyMatrix4(host.world().clone().invert()).toArray();
  const number = (value, digits) => {
    const text = Math.abs(value).toFixed(digits);
    return (value < 0 && Number(text) ? "\u2212" : "") + text;
  };

  // ---- the ground, and places on the Earth ----

  // The surface of the ground: its corners in a square grid of n x n, the highest and lowest down coordinate, and the cell [m]; null: z = 0.
  let relief = null;
  const reliefOf = () => {
    const own = host.nodes()[data.surface]?.message?.props?.vertices;
    if (!own) return null;
    if (relief?.own === own) return relief;
    const at = host.floats(own), n = Math.round(Math.sqrt(at.length / 3));
    let [top, bottom] = [Infinity, -Infinity];
    for (let k = 2; k < at.length; k += 3) { top = Math.min(top, at[k]); bottom = Math.max(bottom, at[k]); }
    return (relief = { own, at, n, top, bottom, cell: Math.max(0.5, Math.abs(at[at.length - 3] - at[0]) / (n - 1)) });
  };
  // Down coordinate [m] of the ground; null beyond its surface.
  const ground = (north, east, surface = reliefOf()) => {
    if (!surface) return 0;
    const { at, n } = surface, last = at.length - 3;
    const row = ((n - 1) * (north - at[0])) / (at[last] - at[0]), column = ((n - 1) * (east - at[1])) / (at[last + 1] - at[1]);
    if (!(row >= 0 && column >= 0 && row <= n - 1 && column <= n - 1)) return null;
    const i = Math.min(n - 2, Math.floor(row)), j = Math.min(n - 2, Math.floor(column)), f = row - i, g = column - j;
    const down = (a, b) => at[3 * ((i + a) * n + j + b) + 2];
    return (1 - f) * ((1 - g) * down(0, 0) + g * down(0, 1)) + f * ((1 - g) * down(1, 0) + g * down(1, 1));
  };
  // The camera NED [m], and the direction of length 1 in which it sees a pixel of the canvas.
  const rayOf = (x, y, box) => {
    const { camera } = host.m(), far = nedOf(vector((2 * x) / box.width - 1, 1 - (2 * y) / box.height, 0.5).unproject(camera));
    return rayTo(far);
  };
  const rayTo = (ned) => {
    const eye = nedOf(host.m().camera.position), way = ned.map((value, axis) => value - eye[axis]), size = Math.hypot(...way);
    return { eye, way: way.map((value) => value / size), size };
  };
  // How far [m] the ground is on a ray; Infinity for the sky. On uneven ground, by steps of half a cell, then halves.
  const farOf = ({ eye, way }) => {
    const surface = reliefOf(), { top, bottom, cell } = surface ?? { top: 0, bottom: 0, cell: 1 }, to = (down) => (down - eye[2]) / way[2];
    if (eye[2] < top && !(way[2] > 1e-9)) return Infinity;
    const first = eye[2] < top ? to(top) : 0, level = Math.hypot(way[0], way[1]);
    // Beyond 100 km there is the horizon.
    const last = Math.min(way[2] > 1e-9 ? to(bottom) : Infinity, 1e5 / Math.max(level, 1e-9));
    if (first > last) return Infinity;
    if (top === bottom) return first > 0 ? first : Infinity;
    const above = (s) => { const g = ground(eye[0] + s * way[0], eye[1] + s * way[1], surface); return g === null ? NaN : g - eye[2] - s * way[2]; };
    const step = Math.max((last - first) / 4000, Math.min((0.5 * cell) / Math.max(level, 1e-9), (last - first) / 20), 1e-3);
    for (let s = first; s < last + step; s += step) {
      if (!(above(s + step) < 1e-6)) continue;
      let [low, high] = [s, s + step];
      for (let turn = 0; turn < 30; turn++) { const half = (low + high) / 2; if (above(half) < 0) high = half; else low = half; }
      return high;
    }
    return Infinity;
  };
  const along = ({ eye, way }, s) => eye.map((value, axis) => value + s * way[axis]);
  // Where a pixel of the canvas shows the ground, NED [m]; null for the sky.
  const groundAt = (x, y, box) => { const ray = rayOf(x, y, box), far = farOf(ray); return far < Infinity ? along(ray, far) : null; };

  // ---- obstacles: what is in front, and corners near the pointer ----

  const solids = solidsIn(host), NEAR = 10;
  // Whether something hides a place NED that is `slack` [m] in front of it or more.
  const hides = (ned, slack) => {
    const ray = rayTo(ned);
    return Math.min(solids.cast(ray.eye, ray.way)?.far ?? Infinity, host.shown(host.nodes(), "/world/ground") ? farOf(ray) : Infinity) < ray.size - slack;
  };
  // What a pixel shows: its place NED [m], and in one word what is there; null for the sky.
  const placeAt = (x, y, box) => {
    const ray = rayOf(x, y, box), seen = [[0, 0], [-1, -1], [1, -1], [-1, 1], [1, 1]].map(([dx, dy]) => {
      const own = rayOf(x + 0.7 * NEAR * dx, y + 0.7 * NEAR * dy, box);
      return solids.cast(own.eye, own.way);
    });
    const close = [...new Set(seen.map((hit) => hit?.solid))].flatMap((solid) => (solid ? solids.corners(solid) : [])).flatMap((ned) => {
      const spot = host.pixelOf(host.at3(...ned), box), off = spot && Math.hypot(spot.x - x, spot.y - y);
      return spot && off < NEAR ? [{ ned, off }] : [];
    });
    // Of two corners over each other the upper one is seen.
    close.sort((a, b) => (Math.abs(a.off - b.off) < 0.5 ? a.ned[2] - b.ned[2] : a.off - b.off));
    const corner = close.find(({ ned }) => !hides(ned, 0.05));
    if (corner) return { ned: corner.ned, what: "corner" };
    const hit = seen[0], far = farOf(ray);
    if (hit && hit.far < far) {
      const ned = along(ray, hit.far);
      return { ned, what: ned[2] < hit.solid.low[2] + 0.01 ? "roof" : "wall" };
    }
    return far < Infinity ? { ned: along(ray, far), what: "ground" } : null;
  };
  // Latitude and longitude [deg] of a place NED [m] on WGS 84.
  const geodetic = ([north, east, down]) => {
    const a = 6378137, e2 = 6.69437999014e-3, [lat0, lon0] = data.site.map((value) => (value * Math.PI) / 180);
    const [s, c, sl, cl] = [Math.sin(lat0), Math.cos(lat0), Math.sin(lon0), Math.cos(lon0)], n0 = a / Math.sqrt(1 - e2 * s * s);
    const outwards = (n0 + data.site[2] - down) * c - north * s;
    const x = outwards * cl - east * sl, y = outwards * sl + east * cl, z = (n0 * (1 - e2) + data.site[2] - down) * s + north * c;
    const p = Math.hypot(x, y);
    let lat = Math.atan2(z, p * (1 - e2));
    for (let turn = 0; turn < 5; turn++) {
      const n = a / Math.sqrt(1 - e2 * Math.sin(lat) ** 2);
      lat = Math.atan2(z + e2 * n * Math.sin(lat), p);
    }
    return [(lat * 180) / Math.PI, (Math.atan2(y, x) * 180) / Math.PI];
  };

  // ---- the scale bar, which holds at the middle of the view ----

  const scale = make("div", "qrsim-scale", host.root), scaleText = make("span", "", scale), scaleBar = make("div", "", scale);
  scale.title = "so long at the middle of the view";
  const compass = make("div", "qrsim-compass", scale);
  compass.title = "north";
  compass.innerHTML = '<svg viewBox="-12 -14 24 28"><path d="M0 -5L4.5 9L0 6L-4.5 9Z"/><text y="-6.5" text-anchor="middle">N</text></svg>';
  // Where the camera looks, or what is up in a view from above.
  const heading = () => {
    const { camera } = host.m(), eye = nedOf(camera.position), from = (x, y, z) => nedOf(camera.localToWorld(vector(x, y, z))).map((v, i) => v - eye[i]);
    const ahead = from(0, 0, -1), way = Math.hypot(ahead[0], ahead[1]) > 0.2 ? ahead : from(0, 1, 0);
    return Math.atan2(way[1], way[0]);
  };
  const layScale = (box) => {
    const control = host.m().cameraControl;
    const far = control.getPosition(vector()).distanceTo(control.getTarget(vector()));
    const metres = (2 * far * host.tangent()) / box.height, most = Math.min(160, 0.3 * box.width) * metres;
    const decade = 10 ** Math.floor(Math.log10(most));
    const length = [5, 2, 1].map((part) => part * decade).find((value) => value <= most);
    put(scaleText, length >= 1000 ? `${length / 1000} km` : `${+length.toPrecision(1)} m`);
    scaleBar.style.width = length / metres + "px";
    compass.firstChild.style.transform = `rotate(${(-heading() * 180) / Math.PI}deg)`;
  };

  // ---- the place under the pointer ----

  const pointer = make("div", "qrsim-pointer", host.root);
  let mouse = null;
  // Words for a place; those of flat ground are without its height, which is 0.
  const told = ({ ned, what }) => {
    const parts = [`N ${number(ned[0], 1)} m, E ${number(ned[1], 1)} m`], hilly = !!reliefOf();
    if (data.site) parts.unshift(geodetic(ned).map((value) => number(value, 6) + "\u00b0").join(", "));
    if (what !== "ground" || hilly) parts.push(`${what} ${number(-ned[2], 1)} m`);
    const below = what !== "ground" && hilly ? ground(ned[0], ned[1]) : null;
    if (below !== null) parts.push(`ground ${number(-below, 1)} m`);
    return parts.join(" \u00b7 ");
  };
  // Put words next to the legend and over the scale, which is at the right, if they do not fit next to it.
  const settle = (element, box, up) => {
    const room = host.free(box), left = room.left + 10, fits = left + element.offsetWidth < scale.offsetLeft - 40;
    Object.assign(element.style, { left: left + "px", maxWidth: room.right - left - 10 + "px", bottom: box.height - room.bottom + (fits ? 12 : 44) + up + "px" });
  };
  const say = (box) => {
    const at = mouse ? placeAt(mouse[0], mouse[1], box) : null;
    pointer.style.display = at ? "" : "none";
    if (!at) return;
    pointer.textContent = told(at);
    // Over the words of measuring.
    settle(pointer, box, measuring ? words.offsetHeight + 4 : 0);
  };

  // ---- measuring ----

  const line = host.draw("path", "qrsim-measure"), words = make("div", "qrsim-measured", host.root);
  let measuring = false, ends = [];
  const button = host.tool("Measure", "distance and height between two clicks; Escape ends", () => measure(!measuring));
  const measure = (on) => {
    measuring = on;
    ends = [];
    button.classList.toggle("qrsim-on", on);
    host.again();
  };
  const placeOf = (end) => ("vehicle" in end ? [...host.place().at.subarray(3 * end.vehicle, 3 * end.vehicle + 3)] : end.ned);
  // A vehicle that is seen, also by its label, or else the place; vehicles of a hidden layer, or behind something, are not meant.
  const pick = (x, y, box) => {
    const named = host.labelAt(x, y);
    if (named !== null) return { vehicle: named };
    let best = null;
    if (host.shown(host.nodes(), "/world/vehicles")) data.names.forEach((_, vehicle) => {
      const spot = host.pixel(vehicle, box), off = spot && Math.hypot(spot.x - x, spot.y - y);
      if (!spot || off >= Math.max(14, 0.6 * spot.radius) || (best && off >= best.off)) return;
      if (!hides(placeOf({ vehicle }), 1.5 * host.place().span)) best = { vehicle, off };
    });
    return best ? { vehicle: best.vehicle } : placeAt(x, y, box);
  };
  const layMeasure = (box) => {
    line.style.display = words.style.display = measuring ? "" : "none";
    if (!measuring) return;
    settle(words, box, 0);
    const places = ends.map(placeOf), spots = places.map((ned) => host.pixelOf(host.at3(...ned), box));
    line.setAttribute("d", spots.every(Boolean) ? spots.map((s, i) => `${i ? "L" : "M"}${s.x},${s.y}`).join("") +
      spots.map((s) => `M${s.x - 5},${s.y}h10m-5,-5v10`).join("") : "");
    const named = (end) => ("vehicle" in end ? data.names[end.vehicle] : end.what);
    if (places.length < 2) { words.textContent = places.length ? `${named(ends[0])}: click the second place or vehicle` : "click a place or a vehicle"; return; }
    const [n, e, d] = places[1].map((value, axis) => value - places[0][axis]), level = Math.hypot(n, e);
    const bearing = (((Math.atan2(e, n) * 180) / Math.PI) + 360) % 360;
    words.textContent = `${named(ends[0])} to ${named(ends[1])}: ${Math.hypot(level, d).toFixed(1)} m, level ${level.toFixed(1)} m, ` +
      `height ${number(-d, 1)} m, bearing ${bearing.toFixed(0)}\u00b0`;
    // No number is parted from its unit.
    words.textContent = words.textContent.replace(/(\d) m\b/g, "$1\u00a0m");
  };

  // ---- the lens: the view from the top is that of a map, by a camera far above with a narrow field of view ----

  const DOWN = [-1e-5, 0, -1], NARROW_DEG = 0.2, RELIEF = 5e3;
  const tangentOf = (degrees) => Math.tan((degrees * Math.PI) / 360);
  // Put the narrow lens on or off; true: it was the other. `state.lens` is the camera without it.
  const lens = (narrow) => {
    const { camera } = host.m(), plain = state.lens;
    if (narrow === !!plain) return false;
    if (narrow) {
      state.lens = { fov: camera.fov, near: camera.near, far: camera.far, most: host.m().configuredMaxOrbitDistance };
      camera.fov = NARROW_DEG;
      host.m().configuredMaxOrbitDistance = 1e9;
    } else {
      Object.assign(camera, { fov: plain.fov, near: plain.near, far: plain.far });
      host.m().configuredMaxOrbitDistance = plain.most;
      state.lens = null;
    }
    camera.updateProjectionMatrix();
    host.m().requestRender();
    return true;
  };
  // How many times farther the camera is for the same picture.
  const farther = () => (state.lens ? tangentOf(state.lens.fov) / tangentOf(NARROW_DEG) : 1);
  // Depths are those around what is seen; a turn away from straight down ends the view, with what is in the middle as large as before.
  const keepLens = () => {
    if (!state.lens) return;
    const { camera, cameraControl: control } = host.m(), target = control.getTarget(vector()), away = control.getPosition(vector()).sub(target);
    const far = away.length();
    if (Math.abs(nedOf(away)[2]) < 0.999 * far) {
      away.divideScalar(farther());
      lens(false);
      host.look(target, away, false);
      return;
    }
    const [near, last] = [Math.max(0.3 * far, far - RELIEF), far + RELIEF];
    if (camera.near === near && camera.far === last) return;
    Object.assign(camera, { near, far: last });
    camera.updateProjectionMatrix();
  };

  // ---- views ----

  const choice = make("select", "qrsim-views", tools), STORE = "qrsim-views " + data.title;
  choice.title = "where the camera is";
  const numbers = (values) => Array.isArray(values) && values.length === 3 && values.every(Number.isFinite);
  const kept = () => {
    try {
      const found = JSON.parse(localStorage.getItem(STORE) ?? "[]");
      return Array.isArray(found) ? found.filter((view) => numbers(view?.eye) && numbers(view?.target)).slice(0, 9) : [];
    } catch { return []; }
  };
  const keep = (views) => { try { localStorage.setItem(STORE, JSON.stringify(views)); } catch { /* a file has no storage */ } };
  const vehicle = () => state.chosen ?? state.ride?.vehicle ?? 0;
  const presets = {
    Overview: () => host.frame(true), Top: () => host.frame(true, DOWN),
    Follow: () => { host.follow(null); host.follow(vehicle()); },
    Chase: () => { state.ride = { kind: "chase", vehicle: vehicle() }; },
    Onboard: () => { state.ride = { kind: "onboard", vehicle: vehicle() }; },
  };
  const go = (name) => {
    state.ride = null;
    host.touch();
    if (name in presets) {
      if (name !== "Follow") host.follow(null);
      if (name === "Chase" || name === "Onboard") lens(false);
      presets[name]();
      return;
    }
    const control = host.m().cameraControl;
    if (name === "save") {
      keep([...kept(), { eye: control.getPosition(vector()).toArray(), target: control.getTarget(vector()).toArray(), flat: !!state.lens }].slice(-9));
    } else if (name === "forget") keep([]);
    else {
      const view = kept()[Number(name)];
      host.follow(null);
      if (view) control.setLookAt(...view.eye, ...view.target, !lens(view.flat === true));
    }
    fill();
  };
  const fill = () => {
    const option = (text, value) => Object.assign(make("option", "", choice, text), { value });
    choice.replaceChildren();
    Object.assign(option("View", ""), { disabled: true });
    for (const name of Object.keys(presets)) option(name, name);
    kept().forEach((_, i) => option(`Saved ${i + 1}`, String(i)));
    option("Save this view", "save");
    if (kept().length) option("Forget saved views", "forget");
    choice.value = "";
  };
  choice.onchange = () => { const name = choice.value; choice.value = ""; choice.blur(); go(name); };
  fill();
  // The camera behind, or at the nose of, a vehicle; its horizon stays level.
  const ride = () => {
    if (!state.ride) return;
    const own = vehicle(), [w, x, y, z] = host.place().turn.subarray(4 * own, 4 * own + 4), span = host.place().span;
    const nose = [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)];
    const level = Math.hypot(nose[0], nose[1]) || 1, ahead = [nose[0] / level, nose[1] / level, 0];
    const at = host.place().at.subarray(3 * own, 3 * own + 3), along = (way, far, up) => at3(way.map((v, i) => at[i] + far * v), up);
    const at3 = (ned, up) => host.at3(ned[0], ned[1], ned[2] - up);
    const chase = state.ride.kind === "chase";
    const eye = chase ? along(ahead, -4 * span, 1.4 * span) : along(nose, 0.7 * span, 0);
    const to = chase ? along(ahead, 2 * span, 0) : along(nose, 0.7 * span + 10, 0);
    host.m().cameraControl.setLookAt(...eye.toArray(), ...to.toArray(), false);
  };

  // ---- what the mouse does ----

  let down = null;
  const spot = (event) => { const box = host.canvasBox(); return [event.clientX - box.left, event.clientY - box.top]; };
  const events = {
    pointermove: (event) => { mouse = event.pointerType === "touch" ? null : spot(event); host.again(); },
    pointerleave: () => { mouse = null; host.again(); },
    pointerdown: (event) => { down = spot(event); state.ride = null; },
    pointerup: (event) => {
      const at = spot(event), still = down && Math.hypot(at[0] - down[0], at[1] - down[1]) < 5;
      if (!measuring || !still) return;
      const end = pick(...at, host.canvasBox());
      if (end) ends = ends.length < 2 ? [...ends, end] : [end];
      host.again();
    },
  };
  const escape = (event) => { if (event.key === "Escape" && measuring) measure(false); };
  window.addEventListener("keydown", escape);
  let canvas = null;
  const listen = (to) => {
    for (const [name, act] of Object.entries(events)) {
      canvas?.removeEventListener(name, act);
      to?.addEventListener(name, act);
    }
    canvas = to;
  };
  return {
    listen, ride, go, geodetic, groundAt, placeAt, pick, ground, scale, lens, keepLens, farther, down: DOWN,
    lay: (box) => { layScale(box); say(box); layMeasure(box); },
    boxes: () => [pointer, words],
    ends: () => { listen(null); window.removeEventListener("keydown", escape); },
  };
};
