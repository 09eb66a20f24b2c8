// All vehicles in a table over the scene: where they are, how fast, in which state, at the time shown. `host` is the overlay.
// Only the rows that are seen are there, so that a thousand vehicles cost as much as twenty.
const tableIn = (host) => {
  const { data, state, make, css } = host, kept = (state.table ??= { open: false, by: -1, down: false, filter: "" });
  const ROW = 22, PERIOD_MS = 250, SIGMAS = 7, STATE = 8, STOP = 9, BAND = 1.96;
  const fixed = (digits, scale = 1) => (value) => (Number.isFinite(value) ? (scale * value).toFixed(digits).replace(/^-(0\.?0*)$/, "$1").replace("-", "\u2212") : "\u2013");
  // Heading, width [px], hint, and how a number is written; in the order of an answer (table.py), after the name.
  const columns = [
    ["north m", 76, "north of the origin", fixed(1)], ["east m", 76, "east of the origin", fixed(1)],
    ["height m", 70, "height over the origin", fixed(1)], ["speed m/s", 58, "speed over ground", fixed(1)],
    ["battery %", 62, "charge of the battery", fixed(0, 100)],
    ["estimate error m", 78, "distance between the estimated and the true position", fixed(2)],
    ["estimate sigma m", 78, "standard deviation that the estimator reports, of all three axes", fixed(2)],
    ["error / sigma, worst axis", 104, "error on its worst axis in sigma; above 1.96 the estimate is outside its 95 % band", fixed(2)],
    ["state", 500, "waypoint, failsafe, or when and why it stopped; sorted by the time of the stop", null],
  ];
  const box = make("div", "qrsim-table", host.root), bar = make("div", "qrsim-table-bar", box);
  const words = make("span", "", bar), filter = make("input", "", bar), shut = make("button", "", bar, "\u2715");
  const rows = make("div", "qrsim-table-rows", box), table = make("table", "", rows);
  const head = make("tr", "", make("thead", "", table)), body = make("tbody", "", table);
  // What the rows that are not there would take.
  const gap = () => { const row = make("tr", "", body), cell = make("td", "qrsim-gap", row); cell.colSpan = 10; return { row, cell }; };
  const above = gap(), below = gap();
  const tall = ({ row, cell }, count) => { row.style.display = count ? "" : "none"; cell.style.height = count * ROW + "px"; };
  box.hidden = true;
  filter.placeholder = "name or state";
  filter.type = "search";
  filter.value = kept.filter;
  shut.title = "close (T)";
  shut.onclick = () => toggle(false);
  const button = host.tool("Table", "all vehicles at the time shown (T)", () => toggle());
  const own = (i) => (data.runOf ? data.names[i].slice(2) : data.names[i]);
  let found = null, texts = [], key = null, order = [], pool = [], timer = 0, busy = false, ended = false;

  // ---- the order of the rows ----
  const value = (column, i) => found.floats[column * data.names.length + i];
  const text = (i) => texts[value(STATE, i)] ?? "";
  const compare = (a, b) => {
    if (kept.by < 0) return a - b;
    const side = kept.down ? -1 : 1, parts = (i) => (kept.by === 0 ? own(i) : kept.by - 1 === STATE ? text(i) : "");
    const number = (i) => (kept.by === 0 ? 0 : kept.by - 1 === STATE ? value(STOP, i) : value(kept.by - 1, i));
    const [x, y] = [number(a), number(b)];
    // Numbers that are not known come last, either way.
    if (Number.isFinite(x) !== Number.isFinite(y)) return Number.isFinite(x) ? -1 : 1;
    return (Number.isFinite(x) && side * (x - y)) || side * parts(a).localeCompare(parts(b), undefined, { numeric: true }) || a - b;
  };
  const sort = () => {
    const wanted = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    order = data.names.map((_, i) => i).filter((i) => wanted.every((word) => `${data.names[i]} ${text(i)}`.toLowerCase().includes(word))).sort(compare);
  };
  const headings = [["vehicle", 128, "by name; click a row to select the vehicle"], ...columns].map(([title, width, hint], number) => {
    const cell = make("th", "", head), press = make("button", "", cell, title);
    cell.style.width = width + "px";
    cell.scope = "col";
    press.title = hint;
    // Up, down, and as it was.
    press.onclick = () => {
      if (kept.by !== number) Object.assign(kept, { by: number, down: false });
      else if (kept.down) Object.assign(kept, { by: -1, down: false });
      else kept.down = true;
      press.blur();
      show();
    };
    return { cell, press, title };
  });
  table.style.width = 128 + columns.reduce((sum, column) => sum + column[1], 0) + "px";

  // ---- the rows ----
  const line = () => {
    const row = make("tr", ""), name = make("th", "", row), dot = make("i", "", name), called = make("span", "", name);
    name.scope = "row";
    const cells = columns.map(() => make("td", "", row));
    row.onclick = () => choose(row.vehicle);
    body.insertBefore(row, below.row);
    return { row, dot, called, cells };
  };
  const lay = () => {
    const seen = Math.ceil(rows.clientHeight / ROW) + 2;
    const first = Math.max(0, Math.min(Math.floor(rows.scrollTop / ROW), order.length - seen));
    const shown = order.slice(first, first + seen);
    while (pool.length < shown.length) pool.push(line());
    pool.forEach(({ row, dot, called, cells }, number) => {
      const vehicle = shown[number];
      row.style.display = vehicle === undefined ? "none" : "";
      if (vehicle === undefined) return;
      row.vehicle = vehicle;
      row.className = (vehicle === state.chosen ? "qrsim-on " : "") + (text(vehicle).startsWith("stopped") ? "qrsim-over" : "");
      dot.style.background = css(data.colours[data.colourOf[vehicle]]);
      put(called, data.names[vehicle]);
      called.title = data.names[vehicle];
      columns.forEach(([, , , write], column) => put(cells[column], write ? write(value(column, vehicle)) : text(vehicle)));
      cells[SIGMAS].className = value(SIGMAS, vehicle) > BAND ? "qrsim-out" : "";
      cells[STATE].title = text(vehicle);
    });
    tall(above, first);
    tall(below, order.length - first - shown.length);
  };
  const show = () => {
    headings.forEach(({ cell, press, title }, number) => {
      const sorted = kept.by === number;
      put(press, title + (sorted ? (kept.down ? " \u25be" : " \u25b4") : ""));
      cell.setAttribute("aria-sort", sorted ? (kept.down ? "descending" : "ascending") : "none");
    });
    if (!found) { put(words, "loading ..."); return; }
    sort();
    const stopped = data.names.reduce((sum, _, i) => sum + text(i).startsWith("stopped"), 0);
    const count = order.length < data.names.length ? `${order.length} of ${data.names.length}` : `${order.length}`;
    put(words, `t = ${found.time.toFixed(2)} s, ${count} vehicle${data.names.length > 1 ? "s" : ""}${stopped ? `, ${stopped} stopped` : ""}`);
    lay();
  };
  filter.oninput = () => { kept.filter = filter.value; rows.scrollTop = 0; show(); };
  rows.onscroll = () => { if (found) lay(); };

  // ---- where the numbers come from ----
  const asking = askingIn(() => { busy = false; clearTimeout(timer); timer = setTimeout(poll, 1000); });
  const poll = async () => {
    clearTimeout(timer);
    if (!kept.open || ended) return;
    timer = setTimeout(poll, PERIOD_MS);
    if (busy || document.hidden) return;
    busy = true;
    const answer = await (window.qrsimFilm?.table ? window.qrsimFilm.table() : asking.request({ table: true, known: key }));
    busy = false;
    if (!answer?.floats || answer.floats.length < 10 * data.names.length) return;
    if (answer.texts) [texts, key] = [answer.texts, answer.key];
    found = answer;
    if (kept.open) show();
  };
  const choose = (vehicle) => {
    const wanted = vehicle === state.chosen ? null : vehicle;
    if (window.qrsimFilm) window.qrsimFilm.choose(wanted);
    else asking.say({ choose: wanted, browser: state.browser ?? null });
    // Its mark is there before the server has said so.
    host.choose(wanted);
    lay();
  };

  const toggle = (open = !kept.open) => {
    kept.open = open;
    box.hidden = !open;
    // A table that is opened again has all vehicles.
    if (!open) kept.filter = filter.value = "";
    button.classList.toggle("qrsim-on", open);
    host.again();
    if (open) { show(); poll(); }
  };
  const press = (event) => {
    if (event.target.closest?.("input, textarea, select, [contenteditable]") || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key.toLowerCase() === "t") toggle();
  };
  window.addEventListener("keydown", press);
  // It may be as high as half of what panels leave, and as wide.
  let size = "";
  const fit = (room) => {
    const now = `left:10px;top:${room.top}px;max-width:${Math.round(room.right - 20)}px;max-height:${Math.max(110, Math.round(0.5 * (room.bottom - room.top)))}px`;
    if (box.hidden || now === size) return;
    box.style.cssText = size = now;
    if (found) lay();
  };
  return {
    box, fit, toggle,
    begin: () => { if (kept.open) toggle(true); },
    ends: () => { ended = true; clearTimeout(timer); window.removeEventListener("keydown", press); asking.ends(); },
  };
};
