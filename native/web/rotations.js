// Rotations as matrices of 9 numbers, row by row.

/** Angles of the joints of one bone [rad], of which a fourth takes half of the twist; as physkin_core's `ball_entry`. */
export function anglesOf({ before, after, sign, twist }, rotation) {
  const turn = product(product(before, rotation), after);
  let angles = threeAngles(turn);
  if (twist >= 0) {
    const half = angles[twist] / 2;
    const back = [0, 0, 0];
    back[twist] = Math.sin(-half / 2);
    angles = [...threeAngles(product(turn, matrix(...back, Math.cos(half / 2)))), half];
  }
  return angles.map((angle) => sign * angle);
}

export function matrix(x, y, z, w) {
  return [
    ...[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    ...[2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    ...[2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}

export function product(a, b) {
  return a.map((_, at) => {
    const [row, column] = [3 * Math.floor(at / 3), at % 3];
    return a[row] * b[column] + a[row + 1] * b[column + 3] + a[row + 2] * b[column + 6];
  });
}

// About X, Y and Z, composed in that order. Where the second is a right angle, the first takes all of the outer two.
function threeAngles(m) {
  const middle = Math.asin(Math.min(Math.max(m[2], -1), 1));
  if (Math.hypot(m[0], m[1]) <= 1e-7) return [Math.atan2(m[7], m[4]), middle, 0];
  return [Math.atan2(-m[5], m[8]), middle, Math.atan2(-m[1], m[0])];
}
