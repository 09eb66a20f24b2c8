// Plots under the scene of a replay: any quantity over time, with the time shown as a cursor. Its data stands before it as
// `data`, and the library as `uPlot`. Values come from the server, or from the page itself where it has none (film.js).
(() => {
  // What was open stays open, for a page that has lost its server for a while.
  const before = window.qrsimPlots, last = before ? { ...before.state } : null;
  before?.ends();
  const film = window.qrsimFilm, units = new Map(data.quantities.map(([name, unit]) => [name, unit]));
  const state = { open: false, panels: [], example: false, group: 0, from: 0, to: data.end, time: last?.time ?? 0, active: 0, height: 0 };
  const make = (tag, parent, text, name) => {
    const found = document.createElement(tag);
    if (text !== undefined) found.textContent = text;
    if (name) found.className = name;
    parent?.append(found);
    return found;
  };

  // ---- where values come from ----
  // What was asked for is asked again, once the server is there.
  const asking = askingIn(() => { if (state.open) setTimeout(load, 1000); });
  const request = (wish) => (film ? film.lines(wish) : asking.request(wish));
  // Times and, for each line, its values, the ends of its band, and its extremes; null for a line that there is not.
  const ask = async (lines, from, to, bins) => {
    const wish = { lines, from, to, bins: Math.round(bins) }, answer = await request(wish);
    const width = 2 * Math.min(2000, Math.max(10, wish.bins)), take = (i) => answer.floats.subarray(i * width, (i + 1) * width);
    let part = 1;
    return { times: take(0), lines: answer.lines.map((line) => line && {
      ...line, values: take(part++), lower: line.band ? take(part++) : null, upper: line.band ? take(part++) : null,
    }) };
  };
  const go = (time) => { const wish = { time: Math.min(data.end, Math.max(0, time)) }; (film ? film.wish : asking.say)(wish); };

  // ---- whose lines ----
  const own = (i) => (data.runs.length ? data.vehicles[i].slice(2) : data.vehicles[i]);
  const groups = [...new Set(data.vehicles.map((_, i) => own(i)))].map((name) => [name, data.vehicles.flatMap((_, i) => own(i) === name ? [i] : [])]);
  if (groups.length > 1 && data.vehicles.length <= 100) groups.unshift(["all vehicles", data.vehicles.map((_, i) => i)]);
  // Of very many, one vehicle at first: a hundred lines take a while, and nobody reads them.
  state.group = groups[0][0] === "all vehicles" && data.vehicles.length > 20 ? 1 : 0;
  const members = () => groups[state.group][1];
  const several = () => members().length > 1;
  const DASHES = [[], [7, 4], [2, 3], [9, 3, 2, 3]];
  const HUES = ["#3772f7", "#e78b01", "#0c9261", "#b5669f", "#883739", "#5aa8f2", "#5b38b2", "#7fbd7f"];
  const ink = () => getComputedStyle(dock).color;
  // Vehicles of one colour, such as those of a run, in shades of it.
  const shade = (vehicle) => {
    const hue = window.qrsim?.colour(vehicle) ?? HUES[vehicle % 8], alike = members().filter((other) => window.qrsim?.colour(other) === hue);
    return alike.length < 2 ? hue : `color-mix(in oklab, ${hue}, ${ink()} ${Math.round((70 * alike.indexOf(vehicle)) / alike.length)}%)`;
  };
  const linesOf = (panel) => panel.names.flatMap((name, row) => members().map((vehicle) => ({
    name, vehicle, dash: several() ? DASHES[row % 4] : [],
    hue: several() ? shade(vehicle) : name.startsWith("truth.") && panel.names.length > 1 ? null : HUES[row % 8],
  })));

  // ---- the panel ----
  const dock = make("div", document.body);
  dock.id = "qrsim-plots";
  dock.hidden = true;
  const style = make("style", document.head, data.css);
  const handle = make("div", dock, "", "handle"), bar = make("div", dock, "", "bar"), body = make("div", dock, "", "body");
  const search = make("input", bar), found = make("div", dock, "", "found"), who = make("select", bar);
  const PLACEHOLDER = "Add a quantity: fence, north, wind, gnss error ...";
  search.placeholder = PLACEHOLDER;
  search.type = "search";
  groups.forEach(([name], i) => { make("option", who, name).value = i; });
  who.title = "whose values";
  who.value = state.group;
  who.onchange = () => { state.group = Number(who.value); who.blur(); build(); };
  const tool = (text, title, act) => { const button = make("button", bar, text); button.title = title; button.onclick = () => { act(); button.blur(); }; };
  tool("New plot", "the next quantity gets a plot of its own", () => { state.active = state.panels.length; search.focus(); });
  tool("Whole time", "undo the zoom (or double-click a plot)", () => zoom(0, data.end));
  tool("Highlights, events", "show or hide the list", () => { events.hidden = !events.hidden; list.load(); size(); });
  tool("\u2715", "close (P)", () => toggle(false));
  const panels = make("div", body, "", "panels"), events = make("div", body, "", "events");
  events.hidden = innerWidth < 900;

  const matches = (text) => {
    const words = text.toLowerCase().split(/[\s_.]+/).filter(Boolean);
    const fits = (...texts) => { const all = texts.join(" ").toLowerCase(); return words.every((word) => all.includes(word)); };
    const together = data.together.filter(([title, names]) => fits(title, ...names)).map(([title, names]) => ({ title, names, doc: names.join(", ") }));
    const single = data.quantities.filter(([name, unit, doc]) => fits(name, doc)).map(([name, unit, doc]) => ({ title: name + (unit && unit !== "1" ? ` [${unit}]` : ""), names: [name], doc }));
    // A word in the name counts more than one in the explanation.
    const inName = (item) => words.every((word) => item.title.toLowerCase().includes(word)) ? 0 : 1;
    return [...together, ...single].sort((a, b) => inName(a) - inName(b));
  };
  // Modes and states are words, and no quantities: the table has them, unless further words name a quantity.
  const inTable = (text, some) => /(^|\s)(modes?|states?)(\s|$)/i.test(text) && !(some.length && /\s/.test(text.trim()));
  const openTable = () => { search.value = ""; search.blur(); leave(); window.qrsim?.table.toggle(true); };
  const suggest = () => {
    found.replaceChildren();
    found.hidden = false;
    const some = matches(search.value), elsewhere = inTable(search.value, some);
    if (elsewhere) make("button", found, "Table (T), column state: modes and states of all vehicles", "first").onpointerdown = (event) => { event.preventDefault(); openTable(); };
    some.slice(0, 60).forEach((item, i) => {
      const row = make("button", found, item.title, i || elsewhere ? "" : "first");
      make("br", row);
      make("small", row, item.doc);
      row.onpointerdown = (event) => { event.preventDefault(); add(item.names); };
    });
    if (!some.length && !elsewhere) make("small", found, "nothing of this name was logged");
    else if (some.length > 60) make("small", found, `and ${some.length - 60} more`);
  };
  search.onfocus = search.oninput = suggest;
  // The search ends: with a choice, or without.
  const leave = () => { found.hidden = true; replacing = null; search.placeholder = PLACEHOLDER; };
  search.onblur = leave;
  search.onkeydown = (event) => {
    if (event.key === "Enter") {
      const some = matches(search.value);
      if (inTable(search.value, some)) openTable();
      else if (some.length) add(some[0].names);
    }
    if (event.key === "Escape") search.blur();
  };
  found.hidden = true;
  const unitsOf = (names) => [...new Set(names.map((name) => units.get(name)))];
  // A plot has an axis on each side; one with many lines is not mixed with another unit.
  const fits = (names, more) => unitsOf([...names, ...more]).length <= (names.length > 2 ? 1 : 2);
  // The line [plot, name] whose place the next quantity takes; null: it is added.
  let replacing = null;
  const add = (names) => {
    const [old, name] = replacing ?? [];
    // The plot that is there at first is an example.
    if (!old && state.example && state.active < state.panels.length) state.panels = [];
    state.example = false;
    const at = old ? state.panels.indexOf(old) : state.active, panel = state.panels[at];
    const others = panel ? panel.names.filter((other) => other !== name) : [];
    if (panel && fits(others, names)) {
      panel.names = [...new Set(old ? panel.names.flatMap((other) => (other === name ? names : [other])) : [...others, ...names])];
      state.active = at;
    } else {
      if (old) old.names = others;
      state.panels.push({ names: [...names] });
      state.active = state.panels.length - 1;
    }
    state.panels[state.active].fresh = true;
    search.value = "";
    search.blur();
    leave();
    build();
  };
  const replace = (panel, name) => {
    search.focus();
    replacing = [panel, name];
    search.placeholder = `In place of ${short(panel, name)}: ...`;
  };
  // Remove a line, or without a name the whole plot.
  const drop = (panel, name) => {
    panel.names = panel.names.filter((other) => name !== undefined && other !== name);
    state.example = false;
    if (!panel.names.length) { state.panels = state.panels.filter((other) => other !== panel); state.active = 0; }
    build();
  };

  // ---- events (events.js) ----
  const list = eventsIn({ parent: events, make, go, highlights: async () => (await request({ lines: [], highlights: true })).highlights });

  // ---- the plots ----
  const number4 = (value) => value === null || value === undefined || !Number.isFinite(value) ? "\u2013" : Math.abs(value) >= 1e5 || (value !== 0 && Math.abs(value) < 1e-3) ? value.toExponential(2) : String(+value.toPrecision(4)).replace("-", "\u2212");
  const whose = (vehicle) => (several() ? (data.runs.length && groups[state.group][0] !== "all vehicles" ? data.vehicles[vehicle][0] : data.vehicles[vehicle]) + " " : "");
  const tip = tipIn({ make, dock, words: (panel, line) => whose(line.vehicle) + short(panel, line.name), number4 });
  const marks = marksIn({ state, ink, unitsOf, units, rare: list.rare });
  const options = (panel, lines, width, height) => {
    const axes = unitsOf(panel.names), grid = { stroke: "rgba(128,128,128,.22)", width: 1 };
    const series = [{ label: "t" }], bands = [];
    for (const line of lines) {
      const scale = "y" + axes.indexOf(units.get(line.name));
      series.push({ scale, stroke: line.hue ?? ink, width: members().length > 12 ? 1 : 1.6, dash: line.dash, points: { show: false } });
    }
    for (const line of lines.filter((line) => line.band)) {
      const scale = "y" + axes.indexOf(units.get(line.name)), first = series.length;
      series.push({ scale, points: { show: false }, width: 0 }, { scale, points: { show: false }, width: 0 });
      bands.push({ series: [first + 1, first], fill: (line.hue ?? "#888888") + "38" });
    }
    // All plots are as wide, also where only one of them has an axis on the right.
    const values = (plot, ticks) => ticks.map(number4), two = state.panels.some(({ names }) => unitsOf(names).length > 1);
    return {
      width, height, series, bands, legend: { show: false }, focus: { prox: -1 }, padding: [10, axes.length > 1 ? 0 : two ? 72 : 16, 0, 0],
      cursor: { drag: { x: true, y: false, dist: 6 }, sync: { key: "qrsim-plots" }, points: { show: false } },
      scales: { x: { time: false, min: state.from, max: state.to }, ...Object.fromEntries(axes.map((_, i) => ["y" + i, {}])) },
      axes: [{ stroke: ink, grid, ticks: grid, size: 30, values: (plot, ticks) => ticks.map((t) => number4(t) + " s") },
        ...axes.map((unit, i) => ({ scale: "y" + i, side: i ? 1 : 3, stroke: ink, grid: i ? { show: false } : grid, ticks: grid, size: 56, values,
          label: unit && unit !== "1" ? unit : "", labelSize: 16, labelGap: 0 }))],
      hooks: {
        draw: [marks], setSelect: [], setCursor: [(plot) => tip(plot, panel)],
        setScale: [(plot, key) => { if (key === "x" && !setting) zoom(plot.scales.x.min, plot.scales.x.max); }],
      },
    };
  };
  let setting = false, later = 0;
  // Zoom to a span of time [s], in all plots.
  const zoom = (from, to) => {
    [from, to] = [Math.max(0, from), Math.min(data.end, to)];
    if (!(to - from > 1e-3) || (from === state.from && to === state.to)) return;
    Object.assign(state, { from, to });
    setting = true;
    for (const { plot } of state.panels) plot?.setScale("x", { min: from, max: to });
    setting = false;
    mark();
    clearTimeout(later);
    later = setTimeout(load, 60);
  };
  const width = () => Math.max(120, panels.clientWidth - 2);
  // What the words of all plots leave, in equal parts.
  const tall = () => {
    const words = state.panels.reduce((sum, panel) => sum + panel.words.offsetHeight, 0);
    return Math.max(120, Math.floor((panels.clientHeight - words) / Math.max(1, state.panels.length)) - 2);
  };
  let loads = 0;
  const load = async () => {
    if (!state.open) return;
    const load = ++loads;
    await Promise.all(state.panels.map(async (panel) => {
      const lines = linesOf(panel);
      const answer = await ask(lines.map(({ name, vehicle }) => [name, vehicle]), state.from, state.to, width());
      if (load !== loads) return;
      panel.lines = lines.map((line, i) => ({ ...line, ...answer.lines[i], there: !!answer.lines[i] })).filter((line) => line.there);
      panel.times = answer.times;
      const top = panels.scrollTop;
      tell(panel);
      draw(panel);
      panels.scrollTop = top;
    }));
    if (load !== loads) return;
    for (const { plot } of state.panels) plot?.setSize({ width: width(), height: tall() });
    if (scrolled !== null) panels.scrollTop = scrolled;
    scrolled = null;
    // A plot that has just been added is seen.
    for (const panel of state.panels) { if (panel.fresh) panel.root.scrollIntoView({ block: "nearest" }); panel.fresh = false; }
    exact();
  };
  const draw = (panel) => {
    const bands = panel.lines.filter((line) => line.band), key = panel.lines.map((line) => line.name + line.vehicle + line.band).join();
    const content = [panel.times, ...panel.lines.map((line) => line.values), ...bands.flatMap((line) => [line.lower, line.upper])].map((part) => Array.from(part, (value) => Number.isNaN(value) ? null : value));
    setting = true;
    if (panel.key !== key) {
      panel.plot?.destroy();
      panel.key = key;
      panel.plot = new uPlot(options(panel, panel.lines, width(), tall()), content, panel.box);
      panel.cursor = make("div", panel.plot.over, "", "now-line");
      panel.plot.over.addEventListener("pointerdown", (event) => { panel.down = event.clientX; activate(panel); });
      panel.plot.over.addEventListener("click", (event) => {
        if (Math.abs(event.clientX - panel.down) < 6) go(panel.plot.posToVal(event.clientX - panel.plot.over.getBoundingClientRect().left, "x"));
      });
      panel.plot.over.addEventListener("dblclick", () => zoom(0, data.end));
    } else {
      panel.plot.setData(content, false);
      for (const scale of Object.keys(panel.plot.scales).filter((name) => name !== "x")) panel.plot.setScale(scale, { min: null, max: null });
      panel.plot.setScale("x", { min: state.from, max: state.to });
    }
    setting = false;
    mark();
  };
  const activate = (panel) => {
    state.active = state.panels.indexOf(panel);
    for (const other of state.panels) other.root.classList.toggle("active", other === panel && state.panels.length > 1);
  };
  // Of quantities that belong together, what tells them apart.
  const short = (panel, name) => {
    const set = data.together.find(([, names]) => panel.names.every((own) => names.includes(own)));
    if (!set || panel.names.length < 2) return name.replace(/^derived\./, "");
    const [, part] = name.match(/^(?:commands|measurements)?\.?([a-z_0-9]+)/);
    return `${set[0].split(":")[0]}, ${{ setpoint: "set-point", derived: "truth" }[part] ?? part}`;
  };
  const tell = wordsIn({ make, go, short, whose, replace, drop, number4 });
  // Where the list of plots was scrolled to, before they were made again.
  let scrolled = null;
  const build = () => {
    scrolled ??= panels.scrollTop;
    for (const panel of state.panels) { panel.plot?.destroy(); Object.assign(panel, { plot: null, key: null, lines: [], told: [] }); }
    panels.replaceChildren();
    for (const panel of state.panels) {
      panel.root = make("div", panels, "", "panel");
      const close = make("button", panel.root, "\u2715", "close");
      close.title = "remove this plot";
      close.onclick = () => drop(panel);
      panel.words = make("div", panel.root, "", "lines");
      panel.box = make("div", panel.root);
    }
    activate(state.panels[Math.min(state.active, state.panels.length - 1)]);
    if (!state.panels.length) make("small", panels, "Add a quantity by the search above.");
    size();
  };

  // ---- the time shown ----
  const mark = () => {
    for (const { plot, cursor } of state.panels) {
      if (!plot) continue;
      const x = plot.valToPos(state.time, "x");
      cursor.style.display = x < 0 || x > plot.over.clientWidth ? "none" : "";
      cursor.style.transform = `translateX(${x}px)`;
    }
    list.mark(state.time);
  };
  // Values of lines are of bins; those at the time shown are asked for once it stands still.
  let still = 0;
  const exact = () => {
    clearTimeout(still);
    still = setTimeout(async () => {
      for (const panel of state.panels) {
        const told = panel.told ?? [];
        if (!told.length) continue;
        const now = Math.min(state.time, data.end - 1e-3), answer = await ask(told.map(({ name, vehicle }) => [name, vehicle]), now, now + 1e-3, 10);
        told.forEach((line, i) => { line.value.textContent = number4(answer.lines[i]?.values[0]); });
      }
    }, 120);
  };
  const time = (now) => {
    if (now === state.time) return;
    state.time = now;
    if (!state.open) return;
    mark();
    exact();
  };

  // ---- size, open and close ----
  const size = () => {
    const scene = window.__viserMutable?.canvas?.getBoundingClientRect();
    dock.style.width = Math.max(300, Math.min(innerWidth, scene?.right ?? innerWidth)) + "px";
    state.height ||= Math.round(innerHeight * (innerWidth > 700 ? 0.42 : 0.46));
    dock.style.height = Math.min(state.height, innerHeight - 120) + "px";
    for (const { plot } of state.panels) plot?.setSize({ width: width(), height: tall() });
    load();
  };
  handle.onpointerdown = (event) => {
    handle.setPointerCapture(event.pointerId);
    const end = event.clientY + dock.offsetHeight;
    handle.onpointermove = (move) => { state.height = Math.max(140, end - move.clientY); size(); };
    handle.onpointerup = () => { handle.onpointermove = null; };
  };
  const begin = () => {
    const first = units.has("derived.height") ? "derived.height" : data.quantities[0]?.[0];
    state.panels = first ? [{ names: [first] }] : [];
    state.example = true;
  };
  const toggle = (open = !state.open) => {
    state.open = open;
    dock.hidden = !open;
    if (!open) return;
    if (!state.panels.length) begin();
    build();
    list.load();
  };
  let chosen = null, wide = 0;
  const watch = setInterval(() => {
    // The scene gets wider and narrower with viser's panel.
    const right = window.__viserMutable?.canvas?.getBoundingClientRect().right ?? 0;
    if (right !== wide) { wide = right; if (state.open) size(); }
    const now = window.qrsim?.state.chosen ?? null;
    if (now === chosen) return;
    chosen = now;
    if (now === null) return;
    state.group = groups.findIndex(([name, vehicles]) => name !== "all vehicles" && vehicles.includes(now));
    who.value = state.group;
    if (state.open) build();
  }, 300);
  let resized = 0;
  const onResize = () => { clearTimeout(resized); resized = setTimeout(() => { if (state.open) size(); }, 150); };
  const onKey = (event) => {
    if (event.target.closest?.("input, textarea, select, [contenteditable]") || event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key.toLowerCase() === "p") toggle();
  };
  window.addEventListener("resize", onResize);
  window.addEventListener("keydown", onKey);
  window.qrsimPlots = { state, toggle, add, time, zoom, ends: () => {
    clearInterval(watch);
    window.removeEventListener("resize", onResize);
    window.removeEventListener("keydown", onKey);
    state.open = false;
    asking.ends();
    dock.remove(); style.remove();
  } };
  if (last) {
    const kept = last.panels.map(({ names }) => ({ names: names.filter((name) => units.has(name)) }));
    Object.assign(state, { panels: kept.filter(({ names }) => names.length), example: last.example, height: last.height });
  }
  if (last?.open) toggle(true);
})();
