import type { Ros } from "roslib";
import type { Garment } from "./physkin.js";

type Wasm = { wasm?: string | URL | Response | ArrayBuffer | ArrayBufferView | WebAssembly.Module };

/** What the topics of garments that are published now are below, such as "/drape_node"; asks rosapi. */
export function garmentTopics(ros: Ros): Promise<string[]>;

/** A garment of a node, posed by `physkin_msgs/GarmentNodes`. */
export class GarmentSkin implements Garment {
  /** mesh: a `physkin_msgs/GarmentMesh` as roslib gives it. Throws PhyskinError where it contradicts itself. */
  static of(mesh: object, options?: Wasm): Promise<GarmentSkin>;
  readonly name: string;
  readonly faces: Uint32Array;
  readonly positions: Float32Array;
  readonly normals: Float32Array;
  /** Of the mesh, which garment nodes have, too. */
  readonly revision: number;
  readonly jointNames: readonly string[];
  /** Writes positions and normals; throws PhyskinError for a message that is not of this mesh, or not finite. */
  skin(nodes: object): void;
}

/** Subscribes to one garment's mesh and garment nodes. */
export class GarmentClient {
  constructor(
    ros: Ros,
    topics: string,
    options?: Wasm & {
      onMesh?: (skin: GarmentSkin) => void;
      onFrame?: (skin: GarmentSkin) => void;
      onError?: (error: Error) => void;
    },
  );
  /** Frames that came without a mesh of their revision, or were wrong. */
  readonly skipped: number;
  close(): void;
}
