// What a plot has over its lines: levels that matter, and events as dashed lines with their text.
const marksIn = ({ state, ink, unitsOf, units, rare }) => (plot) => {
  const pen = plot.ctx, { left, top, width, height } = plot.bbox, ratio = devicePixelRatio;
  pen.save();
  pen.strokeStyle = pen.fillStyle = ink();
  pen.font = `${10 * ratio}px sans-serif`;
  pen.textAlign = "left";
  pen.textBaseline = "alphabetic";
  const names = state.panels.find((panel) => panel.plot === plot)?.names ?? [];
  for (const name of names) {
    const scale = "y" + unitsOf(names).indexOf(units.get(name));
    const y = name in data.levels ? plot.valToPos(data.levels[name], scale, true) : -1;
    if (!(y >= top && y <= top + height)) continue;
    pen.strokeStyle = "#c5130c";
    pen.lineWidth = ratio;
    pen.beginPath(); pen.moveTo(left, y); pen.lineTo(left + width, y); pen.stroke();
    pen.strokeStyle = ink();
  }
  let free = left;
  for (const [time, , text] of rare) {
    if (time < plot.scales.x.min || time > plot.scales.x.max) continue;
    const x = plot.valToPos(time, "x", true);
    pen.globalAlpha = 0.45;
    pen.lineWidth = ratio;
    pen.setLineDash([3 * ratio, 3 * ratio]);
    pen.beginPath(); pen.moveTo(x, top); pen.lineTo(x, top + height); pen.stroke();
    if (plot !== state.panels[0]?.plot || x < free) continue;
    const words = text.length > 40 ? text.slice(0, 38) + "\u2026" : text, wide = pen.measureText(words).width + 8 * ratio;
    pen.globalAlpha = 0.9;
    const start = Math.min(x + 3 * ratio, left + width - wide);
    if (start < free) continue;
    pen.fillText(words, start, top + 10 * ratio);
    free = start + wide;
  }
  pen.restore();
};
// The line next to the pointer in words: whose it is, its value, and the time there. `words` names a line of a plot.
const tipIn = ({ make, dock, words, number4 }) => {
  const box = make("div", dock, "", "tip");
  box.hidden = true;
  return (plot, panel) => {
    const { left, top, idx } = plot.cursor, lines = panel.lines ?? [];
    const inside = left >= 0 && top >= 0 && idx !== null && idx !== undefined && plot.over.matches(":hover");
    // Nearest in pixels; of few lines also far from the pointer.
    let best = null;
    if (inside) lines.forEach((line, row) => {
      const value = plot.data[row + 1]?.[idx];
      if (value === null || value === undefined) return;
      const off = Math.abs(plot.valToPos(value, plot.series[row + 1].scale) - top);
      if (!best || off < best.off) best = { line, value, off };
    });
    box.hidden = !best;
    if (!best) return;
    box.textContent = `${words(panel, best.line)} ${number4(best.value)}, ${plot.data[0][idx].toFixed(2)} s`;
    box.style.borderColor = best.line.hue ?? "currentColor";
    const at = plot.over.getBoundingClientRect(), room = dock.getBoundingClientRect();
    box.style.left = Math.min(at.left - room.left + left + 12, room.width - box.offsetWidth - 8) + "px";
    box.style.top = Math.max(0, at.top - room.top + top - 26) + "px";
  };
};
