// Landmarks of a person to joint positions, frame by frame: physkin_core.LandmarkReader step by step, with its numbers
// (`to_json`). X forward, Y left, Z up; vectors are arrays of 3.
import { anglesOf, matrix, product } from "./rotations.js";

const SHOULDERS = [5, 6];
const HIPS = [7, 8];
const TRUNK = [...SHOULDERS, ...HIPS];
const EARS = [3, 4];
const FACE = [0, 1, 2, 3, 4];
const HIPS_ROW = 21; // beside landmarks: the middle of the hips
const [X, Y, Z] = [
  [1, 0, 0],
  [0, 1, 0],
  [0, 0, 1],
];
const SAME = [...X, ...Y, ...Z];

/** table: of `LandmarkReader.to_json`; joints: of an outfit, or as many of one as there are.
 * status: "seen", "part" or "lost"; lost: what is not seen, such as ["left arm", "head"]. */
export class LandmarkReader {
  #table;
  #joints;
  #balls;

  constructor(table, joints) {
    const index = new Map(joints.map(({ name }, joint) => [name, joint]));
    this.#table = table;
    this.#joints = joints;
    this.#balls = Object.entries(table.balls).map(([bone, ball]) => {
      return { ...ball, bone, joints: ball.joints.map((joint) => index.get(joint) ?? -1) };
    });
    this.reset();
  }

  /** Starts anew, with another person. */
  reset() {
    this.points = Array.from({ length: HIPS_ROW + 1 }, (_, row) => {
      const value = this.#table.standing[TRUNK.indexOf(row)] ?? [0, 0, 0];
      return { value, speed: [0, 0, 0], at: -Infinity };
    });
    this.bones = new Map([...this.#balls.map(({ bone }) => bone), "root"].map((bone) => [bone, { at: -Infinity, trust: 0 }]));
    Object.assign(this, { time: -Infinity, sizes: [], hinges: {}, root: SAME, place: [0, 0, 0.914], floor: NaN });
    Object.assign(this, { status: "lost", lost: ["trunk"], positions: this.#joints.map(({ rest }) => rest) });
  }

  /** points: { x, y, z, visibility } of each landmark, in the tracker's axes; null where nobody is seen. time [s].
   * Returns joint positions, and the root in glTF's axes as `Outfit.step` takes it. */
  read(points, time) {
    const { count, columns, axes, farthest, least_confidence: least } = this.#table;
    if (time < this.time) this.reset();
    const passed = Math.min(time - this.time, 10);
    this.time = time;
    const found = columns.map((column) => {
      if (points === null || column === count) return null; // not seen
      const { x, y, z, visibility = 1 } = points[column];
      const good = Math.max(...[x, y, z].map(Math.abs)) < farthest && norm([x, y, z]) > 0 && visibility >= least;
      return good ? turned(axes, [x, y, z]) : null;
    });
    let turns = new Map();
    [this.status, this.lost] = ["lost", ["trunk"]];
    if (this.#measured(found) && TRUNK.filter((row) => found[row]).length > 1) {
      const seen = this.#smooth(found, passed);
      [turns, this.lost] = this.#turns(seen, this.#table.straight * Math.exp(-passed / this.#table.recent));
      if (!HIPS.every((row) => found[row])) this.lost.push("hips");
      this.status = this.lost.length > 0 ? "part" : "seen";
      this.#stand(seen, passed);
    }
    this.#follow(turns, passed);
    const [x, y, z] = this.place;
    const [i, j, k, w] = quaternion(this.root);
    return { positions: this.positions.slice(), root: [y, z, x, j, k, i, w] };
  }

  #measured(found) {
    const { limbs, plausible, sizes, up } = this.#table;
    let halves = limbs.flatMap(({ halves }) => halves).filter(([a, b]) => found[a] && found[b]);
    if (this.sizes.length === 0 && halves.length === 0) {
      halves = HIPS.filter((hip) => found[hip] && found[hip - 2]).map((hip) => [hip, hip - 2, up[2]]);
    }
    const ratios = halves.map(([a, b, length]) => norm(minus(found[b], found[a])) / length);
    if (ratios.length > 0 && median(ratios) > 0) this.sizes = [...this.sizes, median(ratios)].slice(-sizes);
    if (this.sizes.length === 0) return false;
    this.size = median(this.sizes);
    halves.forEach(([, end], at) => {
      const size = ratios[at] / this.size;
      if (!(plausible[0] < size && size < plausible[1])) found[end] = null;
    });
    return true;
  }

  #smooth(found, passed) {
    const { speed_hz, slowest_hz, hz_a_speed, carry, recent, standing, up, ease } = this.#table;
    const at = (row) => this.points[row].value;
    const scaled = found.map((point) => point && times(1 / this.size, point));
    const hips = HIPS.every((row) => scaled[row])
      ? mean(HIPS.map((row) => scaled[row]))
      : mean(TRUNK.filter((row) => scaled[row]).map((row) => minus(scaled[row], at(row))));
    [...scaled.map((point) => point && minus(point, hips)), hips].forEach((here, row) => {
      const point = this.points[row];
      if (here === null) {
        point.speed = times(Math.exp(-passed / carry), point.speed);
        point.value = plus(point.value, times(passed, point.speed));
        return;
      }
      const since = Math.max(this.time - point.at, 1e-6);
      const seen = times(1 / since, minus(here, point.value));
      point.speed = plus(point.speed, times(letThrough(speed_hz, since), minus(seen, point.speed)));
      const cutoff = slowest_hz + hz_a_speed * norm(point.speed);
      point.value = plus(point.value, times(letThrough(cutoff, since), minus(here, point.value)));
      point.at = this.time;
    });
    const counts = this.points.slice(0, HIPS_ROW).map((point) => this.time - point.at < recent);
    if (!HIPS.some((row) => counts[row])) {
      const [left, right] = SHOULDERS.map(at);
      const [x, y] = minus(left, right);
      const below = turnOf([x, y, 0], Z, Y, Z);
      HIPS.forEach((row, side) => {
        const wanted = plus(mean([left, right]), turned(below, minus(standing[2 + side], up)));
        this.points[row].value = plus(at(row), times(1 - Math.exp(-passed / ease), minus(wanted, at(row))));
      });
    }
    TRUNK.forEach((row) => (counts[row] = true));
    return counts;
  }

  #turns(seen, memory) {
    const { chains, limbs, columns, count, up, ahead } = this.#table;
    const at = this.points.map(({ value }) => value);
    const middle = (rows) => mean(rows.map((row) => at[row]));
    const above = minus(middle(SHOULDERS), middle(HIPS));
    const [root, chest] = [HIPS, SHOULDERS].map(([left, right]) => turnOf(minus(at[left], at[right]), above, Y, up));
    const turns = new Map([["root", root]]);
    const share = (bones, from, to) => bones.forEach((bone) => turns.set(bone, partOf(product(transposed(from), to), 1 / 3)));
    share(chains[0], root, chest);
    const lost = limbs.filter(({ rows }) => !rows.slice(0, 3).every((row) => seen[row])).map(({ name }) => name);
    if (FACE.every((row) => seen[row])) {
      const nose = minus(middle([0, 1, 2]), middle(EARS));
      share(chains[1], chest, turnOf(minus(at[3], at[4]), nose, Y, ahead));
    } else if (FACE.every((row) => columns[row] < count)) {
      lost.push("head");
    }
    for (const limb of limbs) this.#bend(limb, at, seen, limb.name.includes("arm") ? chest : root, memory, turns);
    return [turns, lost];
  }

  #bend(limb, at, seen, carrier, memory, turns) {
    const { natural, heel_to_toe, ankle_to_toe } = this.#table;
    const [a, b, c, heel, toe] = limb.rows;
    const [upper, lower] = [unit(minus(at[b], at[a])), unit(minus(at[c], at[b]))];
    if (!seen[a] || !seen[b] || norm(upper) === 0) return;
    const least = turned(smallestTurn(limb.upper, turned(transposed(carrier), upper)), limb.axis);
    const kept = plus(times(memory, this.hinges[limb.name] ?? least), times(natural, least));
    let [axis, atRest, bend] = [turned(carrier, kept), times(memory + natural, limb.axis), null];
    if (seen[c] && norm(lower) > 0) {
      const cosine = (dot(upper, lower) - limb.constant) / limb.reach;
      bend = axisTurn(limb.axis, limb.straight + Math.acos(Math.min(Math.max(cosine, -1), 1)));
      axis = plus(axis, cross(upper, lower));
      atRest = plus(atRest, cross(limb.upper, turned(bend, limb.lower)));
    }
    const above = turnOf(upper, axis, limb.upper, atRest);
    const own = product(transposed(carrier), above);
    this.hinges[limb.name] = turned(own, limb.axis);
    turns.set(limb.bones[0], own);
    if (bend === null) return;
    turns.set(limb.bones[1], bend);
    if (toe === undefined || !seen[toe]) return;
    const [start, sole] = seen[heel] ? [heel, heel_to_toe] : [c, ankle_to_toe];
    const shin = product(above, bend);
    const across = turned(shin, Y);
    const mirrored = sole.map((each, axis) => each * limb.foot[axis]);
    turns.set(limb.bones[2], product(transposed(shin), turnOf(minus(at[toe], at[start]), across, mirrored, Y)));
  }

  #stand(seen, passed) {
    const [x, y, height] = this.points[HIPS_ROW].value;
    const placed = norm([x, y, height]) > 0.1;
    const below = this.#table.soles.filter(([row]) => seen[row]).map(([row, sole]) => this.points[row].value[2] - sole);
    const lowest = height + (below.length > 0 ? Math.min(...below) : -this.place[2]);
    const rise = lowest - this.floor;
    this.floor = placed && rise > 0 ? lowest - rise * Math.exp(-passed / this.#table.sink) : lowest;
    this.place = [placed ? x : 0, placed ? y : 0, height - this.floor];
  }

  #follow(turns, passed) {
    const { held, ease, trust } = this.#table;
    const first = [...this.bones.values()].every(({ at }) => at === -Infinity);
    const shareOf = (bone) => {
      const state = this.bones.get(bone);
      const now = turns.has(bone);
      const wanted = first && now ? 1 : state.trust + (now ? passed : -passed) / trust;
      state.trust = Math.min(Math.max(wanted, 0), 1);
      if (now) state.at = this.time;
      return now ? state.trust : this.time - state.at > held ? 1 - Math.exp(-passed / ease) : 0;
    };
    const wanted = turns.get("root") ?? product(smallestTurn(turned(this.root, Z), Z), this.root);
    this.root = product(this.root, partOf(product(transposed(this.root), wanted), shareOf("root")));
    for (const ball of this.#balls) {
      const share = shareOf(ball.bone);
      anglesOf(ball, turns.get(ball.bone) ?? SAME).forEach((angle, slot) => {
        const joint = ball.joints[slot];
        if (!(joint >= 0)) return;
        const { lower, rest, upper } = this.#joints[joint];
        const off = rest + angle - (lower + upper) / 2;
        const wanted = rest + angle - 2 * Math.PI * Math.floor(off / (2 * Math.PI) + 0.5);
        this.positions[joint] += share * (Math.min(Math.max(wanted, lower), upper) - this.positions[joint]);
      });
    }
  }
}

const plus = (a, b) => a.map((each, axis) => each + b[axis]);
const minus = (a, b) => a.map((each, axis) => each - b[axis]);
const times = (factor, vector) => vector.map((each) => factor * each);
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = ([x, y, z], [u, v, w]) => [y * w - z * v, z * u - x * w, x * v - y * u];
const norm = (vector) => Math.sqrt(dot(vector, vector));
const unit = (vector) => times(1 / (norm(vector) || 1), vector);
const mean = (vectors) => times(1 / vectors.length, vectors.reduce(plus));
const turned = (m, vector) => [0, 3, 6].map((row) => dot(m.slice(row, row + 3), vector));
const transposed = (m) => [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]];
const axisTurn = (axis, angle) => matrix(...times(Math.sin(angle / 2), axis), Math.cos(angle / 2));
const letThrough = (cutoff, passed) => 1 / (1 + 1 / (2 * Math.PI * cutoff * passed));

function median(values) {
  const [sorted, half] = [[...values].sort((a, b) => a - b), values.length / 2];
  return (sorted[Math.ceil(half) - 1] + sorted[Math.floor(half)]) / 2;
}

// The rotation that takes two directions at rest to those that are seen, the first exactly.
function turnOf(first, second, firstRest, secondRest) {
  const [seen, rest] = [[first, second], [firstRest, secondRest]].map(([one, two]) => {
    const along = norm(one) > 0 ? unit(one) : X;
    const least = [X, Y, Z].reduce((a, b) => (Math.abs(dot(along, b)) < Math.abs(dot(along, a)) ? b : a));
    const across = cross(along, two);
    const square = unit(dot(across, across) > 1e-18 ? across : cross(along, least));
    return [...along, ...cross(square, along), ...square];
  });
  return product(transposed(seen), rest);
}

// The rotation of least angle between two directions.
function smallestTurn(start, end) {
  const [a, b] = [unit(start), unit(end)];
  if (dot(a, b) < -1 + 1e-9) return turnOf(b, Z, a, Z);
  const half = unit(plus(a, b));
  return matrix(...cross(a, half), dot(a, half));
}

// A share of a rotation; none of half a turn, whose axis is not known.
function partOf(m, share) {
  const axis = [m[7] - m[5], m[2] - m[6], m[3] - m[1]];
  return axisTurn(unit(axis), share * Math.atan2(norm(axis), m[0] + m[4] + m[8] - 1));
}

// Of four products with each of its numbers, x y z w, those with the largest.
function quaternion(m) {
  const [x, y, z] = [m[7] - m[5], m[2] - m[6], m[3] - m[1]];
  const [xy, xz, yz] = [m[1] + m[3], m[2] + m[6], m[5] + m[7]];
  const products = [
    [1 + m[0] - m[4] - m[8], xy, xz, x],
    [xy, 1 - m[0] + m[4] - m[8], yz, y],
    [xz, yz, 1 - m[0] - m[4] + m[8], z],
    [x, y, z, 1 + m[0] + m[4] + m[8]],
  ];
  const [best] = products.sort((a, b) => Math.hypot(...b) - Math.hypot(...a));
  return best.map((each) => each / Math.hypot(...best));
}
