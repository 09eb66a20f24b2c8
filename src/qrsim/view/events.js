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
  make("h4", extremes, "Highlights");
  if (data.events.length) make("h4", rest, `Events (${data.events.length})`);
  const row = (to, time, kind, text) => {
    // The time is in front, and not at the end again; the last time of a list is another one.
    const when = time === null ? "" : time.toFixed(2) + " s", again = kind === "highlight" ? ` at ${when}` : text.match(/,? at [\d.]+ s$/)?.[0];
    const words = again && text.endsWith(again) ? text.slice(0, -again.length) : text;
    const button = make("button", to, `${when && when + "  "}${words}`);
    button.onclick = () => { if (time !== null) go(time); button.blur(); };
    const found = { time, button, words: `${kind} ${text}`.toLowerCase(), often: COMMON.includes(kind), event: to === rest };
    rows.push(found);
    return found;
  };
  for (const [time, kind, text] of data.events) row(rest, time, kind, text);
  let every = false;
  // Without words, only those that are marked in the plots, if there are any.
  const pick = () => {
    const words = filter.value.toLowerCase().split(/\s+/).filter(Boolean);
    // A word is the begin of one; the letter of a run is that run, and not each "a".
    const fits = words.map((word) => new RegExp("(?<![a-z0-9])" + word.replace(/[^\w]/g, "\\$&") + (LETTERS.includes(word) ? "(?![a-z0-9])" : "")));
    const shown = (own) => words.length ? fits.every((fit) => fit.test(own.words)) : every || !own.often || !rare.length;
    for (const own of rows) own.button.style.display = shown(own) ? "" : "none";
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
    const waits = make("small", extremes, "being computed ...");
    const found = data.highlights ?? await highlights();
    waits.remove();
    for (const [time, text] of found) row(extremes, time, "highlight", text);
    extremes.hidden = !found.length;
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
