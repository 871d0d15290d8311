// Clothes on a VRM avatar of @pixiv/three-vrm: joint positions from its normalised bones, cloth on its hips.
import { PhyskinError } from "./physkin.js";
import { anglesOf, matrix } from "./rotations.js";

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
      anglesOf(bone, matrix(facing * x, y, facing * z, w)).forEach((angle, slot) => {
        const joint = bone.joints[slot];
        if (joint >= 0) this.#positions[joint] = this.#rest[joint] + angle;
      });
    }
    return this.#positions;
  }
}

// Models of VRM 0 do.
function looksBack(vrm) {
  return vrm.meta.metaVersion === "0";
}
