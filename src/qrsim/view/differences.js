// Lines from each vehicle of the first run to the same one of another run; their lengths stand in the labels, and mean and largest
// of each run in the legend. `data` is null where there is one run only.
const differencesIn = (svg, data) => {
  const metres = (value) => (value < 100 ? value.toFixed(2) : value.toFixed(0)) + "\u00a0m";
  const lines = document.createElementNS("http://www.w3.org/2000/svg", "path"), said = new Map();
  lines.setAttribute("class", "qrsim-differences");
  svg.append(lines);
  let apart = new Map();
  return {
    // The distance in words of a vehicle of another run; "": none is shown.
    of: (vehicle) => apart.get(vehicle) ?? "",
    draw: (shown, at, pixel, rows) => {
      const runs = new Map();
      let path = "";
      apart = new Map();
      for (const [a, b] of shown ? data.pairs : []) {
        const length = Math.hypot(...[0, 1, 2].map((axis) => at[3 * a + axis] - at[3 * b + axis]));
        if (!Number.isFinite(length)) continue;
        apart.set(b, metres(length));
        const run = runs.get(data.runOf[b]) ?? { total: 0, count: 0, most: 0 };
        runs.set(data.runOf[b], { total: run.total + length, count: run.count + 1, most: Math.max(run.most, length) });
        const [from, to] = [pixel(a), pixel(b)];
        if (from && to) path += `M${from.x.toFixed(1)},${from.y.toFixed(1)}L${to.x.toFixed(1)},${to.y.toFixed(1)}`;
      }
      lines.setAttribute("d", path);
      for (const [run, { total, count, most }] of runs) {
        const words = rows[run].words, much = count > 1 ? `, at most ${metres(most)}` : "";
        if (!said.has(run)) said.set(run, words.textContent);
        words.textContent = `${said.get(run)}: ${metres(total / count)} from A${much}`;
      }
    },
  };
};
