// Landmarks of a person by MediaPipe to joint positions, frame by frame: physkin_core.LandmarkReader step by step, with its
// numbers (`to_json`). X forward, Y left, Z up; vectors are arrays of 3.
import { anglesOf, matrix, product } from "./rotations.js";

const [FACE, EARS, SHOULDERS, HIPS, FEET] = [[0, 1, 2, 3, 4], [3, 4], [5, 6], [7, 8], [15, 16, 19, 20]]; // rows
const TRUNK = [...SHOULDERS, ...HIPS];
const AXES = [[1, 0, 0], [0, 1, 0], [0, 0, 1]];
const [X, Y, Z, SAME] = [...AXES, AXES.flat()];

/** table: of `LandmarkReader("mediapipe").to_json`; joints: of an outfit.
 * status: "seen", "part" or "lost"; lost: what is not seen, such as ["left arm", "head"]. */
export class LandmarkReader {
  #table;
  #state;

  constructor(table, joints) {
    this.#table = { ...table, joints: new Map(joints.map((joint, at) => [joint.name, { ...joint, at }])) };
    const value = (row) => table.standing[TRUNK.indexOf(row)] ?? [0, 0, 0];
    this.#state = {
      points: table.columns.map((_, row) => ({ value: value(row), speed: [0, 0, 0], at: -Infinity })),
      bones: Object.fromEntries(["root", ...Object.keys(table.balls)].map((bone) => [bone, { at: -Infinity, trust: 0 }])),
      ...{ time: -Infinity, sizes: [], forearms: [], leans: [], hinges: {}, root: SAME, height: 0.914 },
      positions: joints.map(({ rest }) => rest),
    };
  }

  /** points: { x, y, z, visibility } of each world landmark; null where nobody is seen. time [s], later than before.
   * Returns joint positions, and the root's height and its rotation, a matrix. */
  read(points, time) {
    const { columns, axes, least_confidence, straight, recent, soles } = this.#table;
    const passed = Math.min(time - this.#state.time, 10);
    this.#state.time = time;
    let found = columns.map((column) => {
      const { x, y, z, visibility } = points?.[column] ?? { visibility: 0 };
      return visibility >= least_confidence ? turned(axes, [x, y, z]) : null;
    });
    let turns = {};
    [this.status, this.lost] = ["lost", ["trunk"]];
    if (this.#measure(found) && TRUNK.filter((row) => found[row]).length > 1) {
      found = found.map((point) => point && times(1 / this.#state.size, point));
      const seen = this.#smooth(this.#inSpace(found), passed);
      [turns, this.lost] = this.#turns(seen, straight * Math.exp(-passed / recent));
      if (!HIPS.every((row) => found[row])) this.lost.push("hips");
      this.status = this.lost.length > 0 ? "part" : "seen";
      const heights = soles.filter(([row]) => seen[row]).map(([row, sole]) => sole - this.#state.points[row].value[2]);
      if (heights.length > 0) this.#state.height = Math.max(...heights);
    }
    this.#follow(turns, passed);
    const { positions, height, root } = this.#state;
    return { positions: positions.slice(), height, root };
  }

  #measure(found) {
    const { limbs, plausible, sizes, up } = this.#table;
    const ends = ([a, b]) => found[a] && found[b];
    let halves = limbs.flatMap((limb) => limb.halves).filter(ends);
    if (this.#state.sizes.length + halves.length === 0) halves = HIPS.map((hip) => [hip, hip - 2, up[2]]).filter(ends);
    const ratios = halves.map(([a, b, length]) => norm(minus(found[b], found[a])) / length);
    if (median(ratios) > 0) this.#state.sizes = [...this.#state.sizes, median(ratios)].slice(-sizes);
    const size = (this.#state.size = median(this.#state.sizes));
    halves.forEach(([, end], at) => {
      if (!(ratios[at] / size > plausible[0] && ratios[at] / size < plausible[1])) found[end] = null;
    });
    return this.#state.sizes.length > 0;
  }

  #inSpace(found) {
    const { clearly, limbs, sizes, stands } = this.#table;
    const state = this.#state;
    for (const [, elbow, wrist] of limbs.filter(({ name }) => name.includes("arm")).map(({ rows }) => rows)) {
      if (!found[elbow] || !found[wrist]) continue;
      const [ahead, left, up] = minus(found[wrist], found[elbow]);
      state.forearms = [...state.forearms, norm([ahead, left, up])].slice(-sizes);
      const length = sorted(state.forearms)[Math.floor(0.75 * state.forearms.length)];
      const deep = Math.sqrt(Math.max(length ** 2 - left ** 2 - up ** 2, ahead ** 2));
      if (Math.abs(ahead) > clearly * length) found[wrist][0] += Math.sign(ahead) * deep - ahead;
    }
    if ([...TRUNK, ...FEET].every((row) => found[row])) {
      const [ahead, , up] = minus(...[SHOULDERS, FEET].map((rows) => mean(rows.map((row) => found[row]))));
      if (up > stands) state.leans = [...state.leans, Math.atan2(ahead, up)].slice(-sizes);
    }
    const level = axisTurn(Y, -median(state.leans) || 0);
    return found.map((point) => point && turned(level, point));
  }

  #smooth(scaled, passed) {
    const { speed_hz, slowest_hz, hz_a_speed, carry, recent, standing, up, ease } = this.#table;
    const { points, time } = this.#state;
    const at = (row) => points[row].value;
    const off = (row) => minus(scaled[row], at(row));
    const both = HIPS.every((row) => scaled[row]);
    const hips = both ? mean(HIPS.map((row) => scaled[row])) : mean(TRUNK.filter((row) => scaled[row]).map(off));
    points.forEach((point, row) => {
      if (!scaled[row]) {
        point.speed = times(Math.exp(-passed / carry), point.speed);
        point.value = plus(point.value, times(passed, point.speed));
        return;
      }
      const here = minus(scaled[row], hips);
      const since = Math.max(time - point.at, 1e-6);
      const moved = minus(here, point.value);
      point.speed = between(point.speed, times(1 / since, moved), letThrough(speed_hz, since));
      point.value = between(point.value, here, letThrough(slowest_hz + hz_a_speed * norm(point.speed), since));
      point.at = time;
    });
    const counts = points.map((point) => time - point.at < recent);
    if (!HIPS.some((row) => counts[row])) {
      const [left, right] = SHOULDERS.map(at);
      const level = turnOf([left[0] - right[0], left[1] - right[1], 0], Z, Y, Z);
      HIPS.forEach((row, side) => {
        const below = plus(mean([left, right]), turned(level, minus(standing[2 + side], up)));
        points[row].value = between(at(row), below, 1 - Math.exp(-passed / ease));
      });
    }
    return counts.map((known, row) => known || TRUNK.includes(row));
  }

  // Rotations of bones from their parents, of "root" from the world; which parts are lost.
  #turns(seen, memory) {
    const { chains, limbs, up, ahead } = this.#table;
    const at = this.#state.points.map(({ value }) => value);
    const middle = (rows) => mean(rows.map((row) => at[row]));
    const above = minus(middle(SHOULDERS), middle(HIPS));
    const [root, chest] = [HIPS, SHOULDERS].map(([left, right]) => turnOf(minus(at[left], at[right]), above, Y, up));
    const turns = { root };
    const share = (bones, from, to) => bones.forEach((bone) => (turns[bone] = partOf(product(inverse(from), to), 1 / 3)));
    share(chains[0], root, chest);
    const lost = limbs.filter(({ rows }) => !rows.slice(0, 3).every((row) => seen[row])).map(({ name }) => name);
    if (FACE.every((row) => seen[row])) {
      const nose = minus(middle(FACE.slice(0, 3)), middle(EARS));
      share(chains[1], chest, turnOf(minus(at[EARS[0]], at[EARS[1]]), nose, Y, ahead));
    } else lost.push("head");
    for (const limb of limbs) this.#bend(limb, at, seen, limb.name.includes("arm") ? chest : root, memory, turns);
    return [turns, lost];
  }

  #bend(limb, at, seen, carrier, memory, turns) {
    const [{ natural }, { hinges }] = [this.#table, this.#state];
    const [[a, b, c, heel, toe], back] = [limb.rows, inverse(carrier)];
    const [upper, lower] = [unit(minus(at[b], at[a])), unit(minus(at[c], at[b]))];
    if (!seen[a] || !seen[b] || norm(upper) === 0) return;
    const least = turned(smallestTurn(limb.upper, turned(back, upper)), limb.axis);
    let axis = turned(carrier, plus(times(memory, hinges[limb.name] ?? least), times(natural, least)));
    let [atRest, bend] = [times(memory + natural, limb.axis), null];
    if (seen[c] && norm(lower) > 0) {
      const cosine = (dot(upper, lower) - limb.constant) / limb.reach;
      bend = axisTurn(limb.axis, limb.straight + Math.acos(Math.min(Math.max(cosine, -1), 1)));
      axis = plus(axis, cross(upper, lower));
      atRest = plus(atRest, cross(limb.upper, turned(bend, limb.lower)));
    }
    const above = turnOf(upper, axis, limb.upper, atRest);
    turns[limb.bones[0]] = product(back, above);
    hinges[limb.name] = turned(turns[limb.bones[0]], limb.axis);
    if (bend === null) return;
    turns[limb.bones[1]] = bend;
    if (toe === undefined || !seen[toe]) return;
    const [start, own] = seen[heel] ? [heel, limb.heel_to_toe] : [c, limb.ankle_to_toe];
    const shin = product(above, bend);
    turns[limb.bones[2]] = product(inverse(shin), turnOf(minus(at[toe], at[start]), turned(shin, Y), own, Y));
  }

  #follow(turns, passed) {
    const { held, ease, trust, balls, joints } = this.#table;
    const { bones, positions, root, time } = this.#state;
    const first = Object.values(bones).every(({ at }) => at === -Infinity);
    const shareOf = (bone) => {
      const [state, now] = [bones[bone], bone in turns];
      state.trust = first && now ? 1 : Math.min(Math.max(state.trust + (now ? passed : -passed) / trust, 0), 1);
      if (now) state.at = time;
      return now ? state.trust : time - state.at > held ? 1 - Math.exp(-passed / ease) : 0;
    };
    const wanted = turns.root ?? product(smallestTurn(turned(root, Z), Z), root);
    this.#state.root = product(root, partOf(product(inverse(root), wanted), shareOf("root")));
    for (const [bone, ball] of Object.entries(balls)) {
      const share = shareOf(bone);
      anglesOf(ball, turns[bone] ?? SAME).forEach((angle, slot) => {
        if (!ball.joints[slot]) return;
        const { at, lower, rest, upper } = joints.get(ball.joints[slot]);
        const rounds = Math.floor((rest + angle - (lower + upper) / 2) / (2 * Math.PI) + 0.5);
        const within = Math.min(Math.max(rest + angle - 2 * Math.PI * rounds, lower), upper);
        positions[at] += share * (within - positions[at]);
      });
    }
  }
}

const plus = (a, b) => a.map((each, axis) => each + b[axis]);
const minus = (a, b) => a.map((each, axis) => each - b[axis]);
const times = (factor, vector) => vector.map((each) => factor * each);
const between = (a, b, share) => plus(a, times(share, minus(b, a)));
const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = ([x, y, z], [u, v, w]) => [y * w - z * v, z * u - x * w, x * v - y * u];
const norm = (vector) => Math.sqrt(dot(vector, vector));
const unit = (vector) => times(1 / (norm(vector) || 1), vector);
const mean = (vectors) => times(1 / vectors.length, vectors.reduce(plus));
const turned = (m, vector) => [0, 3, 6].map((row) => dot(m.slice(row, row + 3), vector));
const inverse = (m) => [m[0], m[3], m[6], m[1], m[4], m[7], m[2], m[5], m[8]];
const axisTurn = (axis, angle) => matrix(...times(Math.sin(angle / 2), axis), Math.cos(angle / 2));
const letThrough = (cutoff, passed) => 1 / (1 + 1 / (2 * Math.PI * cutoff * passed));

const sorted = (values) => [...values].sort((a, b) => a - b);

function median(values) {
  const [ordered, half] = [sorted(values), values.length / 2];
  return (ordered[Math.ceil(half) - 1] + ordered[Math.floor(half)]) / 2;
}

// The rotation that takes two directions at rest to those that are seen, the first exactly; that of least angle.
const turnOf = (first, second, ...atRest) => product(inverse(frame(first, second)), frame(...atRest));
const smallestTurn = (start, end) => turnOf(end, cross(start, end), start, cross(start, end));

function frame(one, two) {
  const along = norm(one) > 0 ? unit(one) : X;
  const least = AXES.reduce((a, b) => (Math.abs(dot(along, b)) < Math.abs(dot(along, a)) ? b : a));
  const across = cross(along, two);
  const square = unit(dot(across, across) > 1e-18 ? across : cross(along, least));
  return [...along, ...cross(square, along), ...square];
}

// A share of a rotation; none of half a turn, whose axis is not known.
function partOf(m, share) {
  const axis = [m[7] - m[5], m[2] - m[6], m[3] - m[1]];
  return axisTurn(unit(axis), share * Math.atan2(norm(axis), m[0] + m[4] + m[8] - 1));
}
