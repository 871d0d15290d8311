import type { VRM } from "@pixiv/three-vrm";
import type { Object3D } from "three";
import type { Outfit } from "./physkin.js";

/** Hangs what three.js draws of garments on the avatar, where its root is. */
export function putOn(vrm: VRM, ...cloths: Object3D[]): void;

/** Joint positions of an outfit from the normalised bones of a VRM avatar. Throws PhyskinError for garments whose rig is
 * not the default one. */
export class VrmPose {
  constructor(outfit: Outfit);
  /** Positions [rad] of all joints, written anew by each call; bones that the avatar lacks are at rest. */
  of(vrm: VRM): Float32Array;
}
