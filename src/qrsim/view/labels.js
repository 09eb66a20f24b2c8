// Changes a text only where it differs: each change costs a layout.
const put = (element, words) => { if (element.textContent !== words) element.textContent = words; };
// Where labels may be, and whether two boxes [left, top, right, bottom] overlap.
const hits = (a, b) => a[0] < b[2] && b[0] < a[2] && a[1] < b[3] && b[1] < a[3];
// Where a label of a size may be, about a vehicle: above, beside, below, and farther off.
const around = (spot, [w, h]) => {
  const off = Math.max(8, 0.7 * spot.radius) + 4, found = [];
  for (const far of [off, off + 26, off + 56]) {
    found.push([spot.x - w / 2, spot.y - far - h], [spot.x + far, spot.y - h / 2], [spot.x - far - w, spot.y - h / 2]);
    found.push([spot.x - w / 2, spot.y + far], [spot.x + far, spot.y - far - h], [spot.x - far - w, spot.y - far - h]);
    found.push([spot.x + far, spot.y + far], [spot.x - far - w, spot.y + far]);
  }
  return found;
};
