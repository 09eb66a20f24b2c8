// What an exported page shows by itself: lines in the label of the selected vehicle, rays to its satellites, and the table.
// `host` is the player (film.js).
const detailsIn = (host) => {
  const { about, lastUpTo } = host;
  const STD = ["x", "y", "z"].map((axis) => "commands.estimate_std.position_ned." + axis);
  let values = null;
  const now = (values, name, time) => {
    const row = about.quantities.indexOf(name);
    if (row < 0 || !values) return NaN;
    const size = values.values.length / about.quantities.length;
    return values.values[row * size + Math.min(size - 1, Math.max(0, Math.floor(time / about.period + 1e-6)))];
  };
  // The failsafe of a vehicle, or its waypoint.
  const doing = (vehicle, time, leg) => {
    const mode = about.modes.filter((mode) => mode[1] === vehicle && mode[0] <= time + 1e-6).at(-1)?.[2], count = about.waypoints[vehicle];
    return mode ? [mode] : count && Number.isFinite(leg) ? [`waypoint ${Math.min(leg + 1, count)} of ${count}`] : [];
  };
  // The same lines as those of a server (labels.py).
  const lines = (vehicle, time) => {
    const at = (name) => now(values, name, time), found = [];
    const [speed, height, charge, leg, error] = ["derived.speed", "derived.height", "truth.battery.charge", "commands.waypoint",
      "derived.estimate_error"].map(at);
    if (Number.isFinite(speed + height)) found.push(`${speed.toFixed(1)} m/s, ${height.toFixed(1)} m high`);
    const parts = doing(vehicle, time, leg);
    if (Number.isFinite(charge)) parts.push(`battery ${(100 * charge).toFixed(0)} %`);
    if (parts.length) found.push(parts.join(", "));
    const std = Math.hypot(...STD.map(at)), short = (value) => String(+value.toPrecision(2));
    if (Number.isFinite(error)) found.push(`estimate ${short(error)} m off` + (Number.isFinite(std) ? ` (sigma ${short(std)} m)` : ""));
    return found;
  };
  const stopped = (vehicle, time) => about.stops.some((stop) => stop[1] === vehicle && stop[0] <= time + 1e-6);
  let said = "", drawn = "";
  const say = (vehicle, time) => {
    const found = vehicle < 0 || stopped(vehicle, time) ? {} : { [vehicle]: lines(vehicle, time) }, key = JSON.stringify(found);
    if (key === said) return;
    said = key;
    window.qrsim?.states(found);
  };
  // Solid, dashed, or short: states of satellites as in rays.py; 3 and 4 are lost.
  const rays = (vehicle, satellites, place) => {
    const own = about.rays, made = own && host.made(own.path);
    if (!made) return;
    const key = JSON.stringify([vehicle, satellites.map((one) => one.slice(1)), place && [...place].map(Math.round)]);
    if (key === drawn) return;
    drawn = key;
    const points = [], colours = [];
    for (const [, azimuth, elevation, , state] of place ? satellites : []) {
      const dashes = own.dashes[state];
      if (!dashes) continue;
      const [turn, high] = [(azimuth * Math.PI) / 180, (elevation * Math.PI) / 180], far = own.reach * (state > 2 ? own.lost : 1);
      const way = [Math.cos(high) * Math.cos(turn), Math.cos(high) * Math.sin(turn), -Math.sin(high)];
      for (const ends of dashes) for (const end of ends) {
        points.push(...way.map((part, axis) => place[axis] + far * end * part));
        colours.push(...(state > 2 ? own.grey : own.colours[vehicle]));
      }
    }
    host.send([{ ...made, props: { ...made.props, points: Float32Array.from(points), colors: Uint8Array.from(colours) } }]);
  };
  // The numbers of all vehicles and their states in words, in the order of a server's answer (table.py).
  const table = async (time, at, valuesOf) => {
    const count = about.vehicles.length, floats = new Float32Array(10 * count).fill(NaN), texts = new Map();
    const stops = new Map(about.stops.filter((stop) => stop[0] <= time + 1e-6).map(([when, vehicle, why]) => [vehicle, [when, why]]));
    const every = await Promise.all(about.vehicles.map((_, vehicle) => valuesOf(vehicle)));
    every.forEach((own, vehicle) => {
      // Values end at the stop; after it the last ones hold.
      const stop = stops.get(vehicle), last = stop ? Math.min(time, stop[0] - 1e-3) : time;
      const of = (name) => now(own, name, last), place = at.subarray(3 * vehicle, 3 * vehicle + 3);
      const text = stop ? `stopped at ${stop[0].toFixed(2)} s: ${stop[1]}` : doing(vehicle, time, of("commands.waypoint")).join();
      if (!texts.has(text)) texts.set(text, texts.size);
      [place[0], place[1], -place[2], stop ? 0 : of("derived.speed"), of("truth.battery.charge"), of("derived.estimate_error"),
        Math.hypot(...STD.map(of)), of("derived.estimate_error_sigmas"), texts.get(text), stop ? stop[0] : NaN].forEach((value, row) => { floats[row * count + vehicle] = value; });
    });
    return { time, texts: [...texts.keys()], floats };
  };
  return {
    table,
    choose: (found) => { values = found; },
    show: (vehicle, time, satellites) => { say(vehicle, time); rays(vehicle, satellites, vehicle < 0 ? null : host.place(vehicle)); },
  };
};
