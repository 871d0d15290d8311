/** Metres, radians; the avatar's root frame in glTF's axes: x left, y up, z forward. */

/** What is wrong, in one sentence: a file that is cut off, damaged or of another version, an unknown joint, a number
 * that is not finite. A frame that throws leaves positions and normals as they were. */
export class PhyskinError extends Error {}

/** One scalar degree of freedom; it turns its bone about `axis` by the position minus `rest`. */
export interface Joint {
  readonly name: string;
  readonly lower: number;
  readonly rest: number;
  readonly upper: number;
  /** Unit vector, in the canonical A-pose. */
  readonly axis: readonly [number, number, number];
}

/** The typed arrays are the garment's own, not views of the module's memory: they stay valid, and each `step` overwrites
 * them. */
export interface Garment {
  readonly name: string;
  /** What it can be made of; the first is what the file was made in. */
  readonly fabrics: readonly string[];
  /** One of `fabrics`: how cloth hangs from the next `step` on. */
  fabric: string;
  /** Three vertices a triangle, counter-clockwise seen from outside. */
  readonly faces: Uint32Array;
  /** x y z a vertex. */
  readonly positions: Float32Array;
  /** Of unit length, x y z a vertex. */
  readonly normals: Float32Array;
}

/** Positions [rad] of all joints in their order, or by name, the others at rest. */
export type JointPositions = ArrayLike<number> | Readonly<Record<string, number>>;

export type Frame =
  /** A root at rest: unit direction of gravity in the root frame, default [0, -1, 0]. Each frame stands by itself. */
  | { gravity?: ArrayLike<number> }
  /** A root that moves: cloth lags, swings and settles. time [s], of any clock; root: x y z [m] and unit quaternion
   * x y z w, world <- root, in a world with Y up; by default it stands at the origin. */
  | { time: number; root?: ArrayLike<number> };

export interface Outfit {
  readonly joints: readonly Joint[];
  /** Bones that joints turn, and the indices of these, in the order in which they are applied. */
  readonly bones: readonly { readonly name: string; readonly joints: readonly number[] }[];
  /** From the skin outwards; as they hang at rest until the first `step`. */
  readonly garments: readonly Garment[];
  /** Text entries of the file. */
  readonly metadata: Readonly<Record<string, string>>;
  /** Computes one frame into the garments' positions and normals. */
  step(joints: JointPositions, frame?: Frame): void;
  /** How much cloth swings with a root that moves, from 0 to 1, which is the default. */
  set sway(amount: number);
  /** Velocity x y z [m/s] of the air, at most 13 long, which is [0, 0, 0] until it is set: in the root's world; of a root at
   * rest in the level frame that faces as it does. */
  set wind(velocity: ArrayLike<number>);
  /** Lets cloth hang still, as if the next frame were the first. */
  reset(): void;
  /** Rotation of each bone relative to its parent and to the canonical pose, as quaternion x y z w: for posing the avatar. */
  boneRotations(joints: JointPositions): Map<string, [number, number, number, number]>;
}

/** Loads what `physkin bind` wrote, gzipped or not, from its address, a Response or its bytes. wasm: the module's address
 * or bytes, if it does not lie beside this file. It is compiled once; each outfit has memory of its own. */
export function loadOutfit(
  source: string | URL | Response | ArrayBuffer | ArrayBufferView,
  options?: { wasm?: string | URL | Response | ArrayBuffer | ArrayBufferView | WebAssembly.Module },
): Promise<Outfit>;
