// Clothes on a VRM avatar of @pixiv/three-vrm: joint positions from its normalised bones, cloth on its hips.
import { PhyskinError } from "./physkin.js";

/** Hangs what three.js draws of garments on the avatar, where its root is. */
export function putOn(vrm, ...cloths) {
  for (const cloth of cloths) cloth.rotation.y = looksBack(vrm) ? Math.PI : 0;
  vrm.humanoid.getNormalizedBoneNode("hips").add(...cloths);
}

/** Joint positions of an outfit for the pose of an avatar. vrm: of @pixiv/three-vrm; bones that it lacks are at rest. */
export class VrmPose {
  #bones;
  #positions;
  #rest;

  constructor(outfit) {
    const table = outfit.metadata.vrm_bones;
    if (table === undefined) throw new PhyskinError("the file knows no bones of VRM: its garments have a rig of their own");
    const index = new Map(outfit.joints.map(({ name }, joint) => [name, joint]));
    this.#bones = Object.entries(JSON.parse(table)).map(([name, bone]) => ({
      ...bone,
      name,
      joints: bone.joints.map((joint) => index.get(joint) ?? -1),
    }));
    this.#rest = Float32Array.from(outfit.joints, ({ rest }) => rest);
    this.#positions = this.#rest.slice();
  }

  /** Positions [rad] of all joints, written anew by each call. */
  of(vrm) {
    const facing = looksBack(vrm) ? -1 : 1;
    for (const bone of this.#bones) {
      const node = vrm.humanoid.getNormalizedBoneNode(bone.name);
      if (node === null) continue;
      const { x, y, z, w } = node.quaternion;
      this.#turn(bone, matrix(facing * x, y, facing * z, w));
    }
    return this.#positions;
  }

  // A rotation taken apart into those about the bone's joints, in their order; half of its twist may be another's.
  #turn({ before, after, joints, sign, twist }, rotation) {
    const turn = product(product(before, rotation), after);
    let angles = threeAngles(turn);
    if (twist >= 0) {
      const half = angles[twist] / 2;
      const back = [0, 0, 0];
      back[twist] = Math.sin(-half / 2);
      angles = [...threeAngles(product(turn, matrix(...back, Math.cos(half / 2)))), half];
    }
    joints.forEach((joint, slot) => {
      if (joint >= 0) this.#positions[joint] = this.#rest[joint] + sign * angles[slot];
    });
  }
}

// Models of VRM 0 do.
function looksBack(vrm) {
  return vrm.meta.metaVersion === "0";
}

// Rotations are matrices of 9 numbers, row by row.

function matrix(x, y, z, w) {
  return [
    ...[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
    ...[2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
    ...[2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
  ];
}

function product(a, b) {
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
