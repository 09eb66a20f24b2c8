// The least distance [m] of two outlines in the plane, 0 if they overlap. An outline is a convex polygon `ring`, widened by `radius` [m].
const betweenOutlines = (a, b) => {
  const edges = (ring) => ring.map((from, i) => [from, ring[(i + 1) % ring.length]]);
  const toEdge = ([x, y], [[x0, y0], [x1, y1]]) => {
    const [dx, dy] = [x1 - x0, y1 - y0], square = dx * dx + dy * dy;
    const part = square ? Math.min(1, Math.max(0, ((x - x0) * dx + (y - y0) * dy) / square)) : 0;
    return Math.hypot(x - x0 - part * dx, y - y0 - part * dy);
  };
  // Separating axes: convex polygons overlap if their projections on the normal of each edge do.
  const normals = [...edges(a.ring), ...edges(b.ring)].map(([[x0, y0], [x1, y1]]) => [y1 - y0, x0 - x1]).filter((way) => way.some(Boolean));
  const parted = ([nx, ny]) => {
    const [own, other] = [a, b].map(({ ring }) => ring.map(([x, y]) => nx * x + ny * y));
    return Math.max(...own) < Math.min(...other) || Math.max(...other) < Math.min(...own);
  };
  if (normals.length && !normals.some(parted)) return 0;
  const nearest = (from, to) => Math.min(...from.flatMap((corner) => edges(to).map((edge) => toEdge(corner, edge))));
  return Math.max(0, Math.min(nearest(a.ring, b.ring), nearest(b.ring, a.ring)) - a.radius - b.radius);
};
// Obstacles as they are drawn, and where a ray meets them first, all in NED [m]. `host` is the overlay.
const solidsIn = (host) => {
  const { data, nodes, floats, shown } = host, read = new Map();
  const ints = (array) => (array instanceof Uint32Array ? array : new Uint32Array(array.buffer, array.byteOffset, array.byteLength / 4));
  // A solid of many that one mesh holds has this many triangles (`solids` in ground.py); instances of a mesh have all of its.
  const FACES = 12;
  // Solids of a node: their triangles, where instances are and how large, and the box around each: six numbers.
  const solidsOf = (node) => {
    const props = node.message.props, old = read.get(node.message.name);
    if (old && old.key === props.vertices) return old.own;
    // Numbers of the obstacles in the scenario; a prism may be several solids.
    const numbers = data.obstacleNumbers?.[node.message.name.slice(data.obstacles.length + 1)] ?? [];
    const points = floats(props.vertices), faces = ints(props.faces), found = [], bounds = [];
    const at = props.batched_positions && floats(props.batched_positions), size = props.batched_scales && floats(props.batched_scales);
    const add = (first, last, offset, scale) => {
      const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
      for (let f = 3 * first; f < 3 * last; f++) for (let axis = 0; axis < 3; axis++) {
        const value = points[3 * faces[f] + axis] * scale[axis] + offset[axis];
        low[axis] = Math.min(low[axis], value); high[axis] = Math.max(high[axis], value);
      }
      found.push({ points, faces, first, last, offset, scale, low, high, number: numbers[found.length] ?? found.length });
      bounds.push(...low, ...high);
    };
    const count = faces.length / 3;
    if (at) for (let k = 0; k < at.length / 3; k++) add(0, count, [...at.subarray(3 * k, 3 * k + 3)], size ? [...size.subarray(3 * k, 3 * k + 3)] : [1, 1, 1]);
    else for (let first = 0; first + FACES <= count; first += FACES) add(first, first + FACES, [0, 0, 0], [1, 1, 1]);
    const own = { solids: found, boxes: Float64Array.from(bounds) };
    read.set(node.message.name, { key: props.vertices, own });
    return own;
  };
  const every = () => {
    const tree = nodes();
    if (!data.obstacles || !shown(tree, data.obstacles)) return [];
    return Object.keys(tree).filter((name) => name.startsWith(data.obstacles + "/") && tree[name]?.message?.props?.faces).map((name) => solidsOf(tree[name]));
  };
  // Distance [m] at which a ray meets a box; Infinity: it does not. A part of a direction is never 0 (`cast`), so nothing is 0 / 0.
  const meets = (boxes, k, eye, way) => {
    let near = 0, far = Infinity;
    for (let axis = 0; axis < 3; axis++) {
      const a = (boxes[6 * k + axis] - eye[axis]) / way[axis], b = (boxes[6 * k + 3 + axis] - eye[axis]) / way[axis];
      if (a < b) { if (a > near) near = a; if (b < far) far = b; } else { if (b > near) near = b; if (a < far) far = a; }
    }
    return near <= far ? near : Infinity;
  };
  // Distance at which a ray meets a triangle of a solid (Moeller and Trumbore 1997, in the frame of its mesh).
  const triangle = ({ points, faces }, f, eye, way) => {
    const [a, b, c] = [0, 1, 2].map((k) => 3 * faces[3 * f + k]);
    const [e1x, e1y, e1z] = [points[b] - points[a], points[b + 1] - points[a + 1], points[b + 2] - points[a + 2]];
    const [e2x, e2y, e2z] = [points[c] - points[a], points[c + 1] - points[a + 1], points[c + 2] - points[a + 2]];
    const px = way[1] * e2z - way[2] * e2y, py = way[2] * e2x - way[0] * e2z, pz = way[0] * e2y - way[1] * e2x;
    const det = e1x * px + e1y * py + e1z * pz;
    if (!(Math.abs(det) > 1e-12)) return Infinity;
    const [tx, ty, tz] = [eye[0] - points[a], eye[1] - points[a + 1], eye[2] - points[a + 2]];
    const u = (tx * px + ty * py + tz * pz) / det;
    const qx = ty * e1z - tz * e1y, qy = tz * e1x - tx * e1z, qz = tx * e1y - ty * e1x;
    const v = (way[0] * qx + way[1] * qy + way[2] * qz) / det, s = (e2x * qx + e2y * qy + e2z * qz) / det;
    return u >= -1e-9 && v >= -1e-9 && u + v <= 1 + 1e-9 && s > 0 ? s : Infinity;
  };
  // The first solid on a ray, and how far it is [m]; null: none.
  const cast = (eye, direction) => {
    let best = null;
    const way = direction.map((value) => value || 1e-12);
    for (const { solids, boxes } of every()) for (let k = 0; k < solids.length; k++) {
      if (meets(boxes, k, eye, way) >= (best?.far ?? Infinity)) continue;
      const solid = solids[k], { offset, scale } = solid, from = eye.map((v, axis) => (v - offset[axis]) / scale[axis]), to = way.map((v, axis) => v / scale[axis]);
      for (let f = solid.first; f < solid.last; f++) {
        const far = triangle(solid, f, from, to);
        if (far < (best?.far ?? Infinity)) best = { solid, far };
      }
    }
    return best;
  };
  // Corners of a solid; none of one with round sides.
  const corners = ({ points, faces, first, last, offset, scale }) => {
    const numbers = [...new Set(faces.subarray(3 * first, 3 * last))].sort((a, b) => a - b);
    return numbers.length > 8 ? [] : numbers.map((k) => [0, 1, 2].map((axis) => points[3 * k + axis] * scale[axis] + offset[axis]));
  };
  // The outline of a solid, in the order of the corners of boxes and of pieces of prisms (ground.py); a cylinder is round.
  const outline = (solid) => {
    const ned = corners(solid);
    if (!ned.length) return { ring: [solid.offset.slice(0, 2)], radius: solid.scale[0] };
    return { ring: [0, 2, 6, 4].map((k) => ned[k].slice(0, 2)), radius: 0 };
  };
  // The least level distance [m] of the walls of two obstacles, by number; 0: one is over the other, or they meet.
  const apart = (one, other) => {
    const [own, others] = [one, other].map((number) => every().flatMap(({ solids }) => solids.filter((solid) => solid.number === number)).map(outline));
    return Math.min(...own.flatMap((a) => others.map((b) => betweenOutlines(a, b))));
  };
  return { cast, corners, apart };
};
