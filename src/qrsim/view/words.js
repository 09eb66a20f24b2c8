// The lines of a plot in words, above it: value at the time shown, lowest and highest with a way to their times.
const wordsIn = ({ make, go, short, whose, replace, drop, number4 }) => (panel) => {
  panel.words.replaceChildren();
  const pick = (lines, side, sign) => lines.reduce((best, line) => (line[side] === null || (best && sign * line[side] <= sign * best[side]) ? best : line), null);
  const ends = (lines) => ({ low: pick(lines, "low", -1), high: pick(lines, "high", 1) });
  const most = Object.fromEntries(panel.names.map((name) => [name, ends(panel.lines.filter((line) => line.name === name))]));
  const few = panel.lines.length <= 10 ? panel.lines : [];
  const title = (row, words, name) => {
    const button = make("button", row, words, "name");
    button.title = `${data.quantities.find(([own]) => own === name)[2]}; click to put another quantity in its place`;
    button.onclick = () => replace(panel, name);
  };
  const range = (row, line, side, words, when, name) => {
    const button = make("button", row, `${words} ${number4(line[side])}`), at = `${line[side + "At"].toFixed(2)} s`;
    button.title = `at ${at}; click to go there`;
    button.onclick = () => go(line[side + "At"]);
    if (when) make("small", row, `${name}at ${at}`);
  };
  const sides = [["min", "low"], ["max", "high"]];
  // Of many lines, a row for each quantity and run: who has the lowest value, and who the highest.
  if (!few.length) for (const name of panel.names) for (const run of data.runs.length ? data.runs.keys() : [0]) {
    const found = ends(panel.lines.filter((line) => line.name === name && data.runOf[line.vehicle] === run));
    if (!found.low) continue;
    const row = make("span", panel.words, "", "line");
    title(row, `${data.runs.length ? data.vehicles[found.low.vehicle][0] + " " : ""}${short(panel, name)}`, name);
    for (const [words, side] of sides) range(row, found[side], side, words, true, data.vehicles[found[side].vehicle] + " ");
    const close = make("button", row, "\u2715");
    close.title = "remove";
    close.onclick = () => drop(panel, name);
  }
  for (const line of few) {
    const row = make("span", panel.words, "", "line"), sign = make("i", row);
    sign.style.borderColor = line.hue ?? "currentColor";
    if (line.dash.length) sign.style.borderTopStyle = "dashed";
    title(row, whose(line.vehicle) + short(panel, line.name), line.name);
    line.value = make("b", row, "");
    // Of several lines, the times of the lowest and the highest of each quantity.
    for (const [words, side] of sides) if (line[side] !== null) range(row, line, side, words, few.length <= 4 || most[line.name][side] === line, "");
    const close = make("button", row, "\u2715");
    close.title = "remove";
    close.onclick = () => drop(panel, line.name);
  }
  if (!panel.lines.length) make("span", panel.words, `${panel.names.join(", ")}: not logged for this vehicle`);
  panel.told = few;
};
