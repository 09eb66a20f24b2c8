// The list next to the plots: highlights of the runs, then events. `host` is the panel of the plots (plots.js).
const eventsIn = ({ parent, make, go, highlights }) => {
  // Kinds that come too often to be marked in plots, or listed at first.
  const LETTERS = data.runs.map((_, run) => "abcdef"[run]);
  const COMMON = ["waypoint_reached", "command_clipped", "satellite_lost"];
  const rare = data.events.filter(([, kind]) => !COMMON.includes(kind)), rows = [];
  const filter = make("input", parent);
  filter.placeholder = "filter highlights and events";
  filter.type = "search";
  const extremes = make("div", parent, "", "highlights"), rest = make("div", parent), more = make("button", parent, "", "more");
  const none = make("small", parent, `0 of ${data.events.length} events; the search of the plots finds logged quantities`);
  // Headings, each with the rows under it: the whole lists, and the sections of the highlights.
  const heads = [], head = (to, tag, text, whole) => { const own = { node: make(tag, to, text), text, whole, rows: [] }; heads.push(own); return own; };
  const high = head(extremes, "h4", "Highlights", true), all = head(rest, "h4", "Events", true);
  const row = (to, time, kind, text, more, under) => {
    // The time is in front, and not at the end again; the last time of a list is another one.
    const when = time === null ? "" : time.toFixed(2) + " s", again = kind === "highlight" ? ` at ${when}` : text.match(/,? at [\d.]+ s$/)?.[0];
    const words = again && text.endsWith(again) ? text.slice(0, -again.length) : text;
    const button = make("button", to, `${when && when + "  "}${words}`);
    button.onclick = () => { if (time !== null) go(time); button.blur(); };
    const found = { time, button, words: `${kind} ${text} ${more}`.toLowerCase(), often: COMMON.includes(kind), event: to === rest };
    rows.push(found);
    for (const own of under) own.rows.push(found);
  };
  for (const [time, kind, text, more] of data.events) row(rest, time, kind, text, more, [all]);
  let every = false;
  // Without words, only those that are marked in the plots, if there are any.
  const pick = () => {
    const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    // A word is the begin of one; the letter of a run is that run, and not each "a".
    const fits = words.map((word) => new RegExp("(?<![a-z0-9])" + word.replace(/[^\w]/g, "\\$&") + (LETTERS.includes(word) ? "(?![a-z0-9])" : "")));
    const shown = (own) => words.length ? fits.every((fit) => fit.test(own.words)) : every || !own.often || !rare.length;
    for (const own of rows) own.button.style.display = shown(own) ? "" : "none";
    for (const { node, text, whole, rows } of heads) {
      const count = rows.filter(shown).length;
      node.hidden = !rows.length || (words.length > 0 && !count);
      if (whole) node.textContent = `${text} (${words.length ? `${count} of ` : ""}${rows.length})`;
    }
    none.hidden = !words.length || rows.some(shown);
    const hidden = rows.filter((own) => !words.length && !shown(own)), kinds = [...new Set(hidden.map((own) => own.words.split(" ")[0].replaceAll("_", " ")))];
    more.style.display = hidden.length ? "" : "none";
    more.textContent = `show ${hidden.length} more: ${kinds.join(", ")}`;
  };
  more.onclick = () => { every = true; pick(); };
  filter.oninput = () => { parent.scrollTop = 0; pick(); };
  pick();
  // They are computed from whole logs, so the server is asked for them once, when the list is first seen.
  let asked = false;
  const load = async () => {
    if (asked || parent.hidden) return;
    asked = true;
    const waits = make("small", extremes, "highlights are being computed ...");
    const found = data.highlights ?? await highlights();
    waits.remove();
    let under = null;
    for (const [time, text, section] of found) {
      if (under?.text !== section) under = head(extremes, "h5", section, false);
      row(extremes, time, "highlight", text, section, [high, under]);
    }
    pick();
  };
  return {
    rare, load,
    mark: (now) => {
      let last = null;
      for (const own of rows) { own.button.classList.remove("now"); if (own.event && own.time <= now + 1e-3) last = own.button; }
      last?.classList.add("now");
    },
  };
};
