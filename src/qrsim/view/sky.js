// The sky over the chosen vehicle, zenith in the middle and north up: what its receiver last said of its satellites.
const skyIn = (root) => {
  const box = document.createElement("div"), title = document.createElement("b"), picture = document.createElement("div");
  const words = document.createElement("div");
  box.className = "qrsim-sky";
  box.hidden = true;
  box.append(title, picture, words);
  root.append(box);
  const kinds = ["other", "tracked", "reflected", "hidden", "jammed"];
  // By their shapes, which all eyes tell apart; the larger, the stronger.
  const sign = (x, y, kind, cn0) => {
    const r = 2.2 + 2.6 * Math.min(1, Math.max(0, (cn0 - 25) / 25));
    if (kind === 1) return `<circle cx="${x}" cy="${y}" r="${r}" fill="currentColor"/>`;
    if (kind === 2) return `<circle cx="${x}" cy="${y}" r="${r}" fill="none" stroke="currentColor" stroke-width="1.6"/>`;
    if (kind === 3) return `<path d="M${x - 4} ${y}h8" stroke="currentColor" stroke-width="2.4" opacity=".6"/>`;
    if (kind === 4) return `<path d="M${x - 3.5} ${y - 3.5}l7 7m0 -7l-7 7" stroke="currentColor" stroke-width="1.8" opacity=".85"/>`;
    return `<circle cx="${x}" cy="${y}" r="1.6" fill="currentColor" opacity=".4"/>`;
  };
  const R = 88, at = (azimuth, elevation) => {
    const r = (R * (90 - elevation)) / 90, turn = (azimuth * Math.PI) / 180;
    return [+(100 + r * Math.sin(turn)).toFixed(1), +(100 - r * Math.cos(turn)).toFixed(1)];
  };
  const rings = [0, 30, 60].map((low) => `<circle cx="100" cy="100" r="${(R * (90 - low)) / 90}" fill="none" stroke="currentColor" opacity=".25"/>`);
  const frame = `${rings.join("")}<path d="M100 12v176M12 100h176" stroke="currentColor" opacity=".15"/>` +
    `<text x="100" y="10" text-anchor="middle">N</text>`;
  return (told) => {
    box.hidden = !told;
    if (!told) return;
    title.textContent = `Sky of ${told.vehicle}`;
    const count = [0, 0, 0, 0, 0], places = told.satellites.map(([, azimuth, elevation]) => at(azimuth, elevation));
    const taken = places.map(([x, y]) => [x - 3, y - 3, x + 3, y + 3]);
    const found = told.satellites.map(([name, , , cn0, kind], number) => {
      count[kind] += 1;
      const [x, y] = places[number], faint = kind === 1 || kind === 2 ? 1 : 0.55, wide = 4.9 * name.length;
      // Next to its sign where there is room, in a corner of it; a name without room is left out.
      const box = [[x + 4, y - 9], [x - 4 - wide, y - 9], [x + 4, y + 2], [x - 4 - wide, y + 2], [x - wide / 2, y - 12], [x - wide / 2, y + 5]]
        .map(([left, top]) => [left, top, left + wide, top + 7]).find((own) => own[0] > 0 && own[2] < 200 && !taken.some((other) => hits(own, other)));
      if (box) taken.push(box);
      return sign(x, y, kind, cn0) + (box ? `<text x="${box[0]}" y="${box[3]}" opacity="${faint}">${name}</text>` : "");
    });
    picture.innerHTML = `<svg viewBox="0 0 200 200">${frame}${found.join("")}</svg>`;
    words.innerHTML = kinds.map((kind, i) => i && (count[i] || i === 1) ?
      `<span><svg viewBox="-6 -6 12 12">${sign(0, 0, i, 42)}</svg>${count[i]} ${kind}</span>` : "").join("");
  };
};
