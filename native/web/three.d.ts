import type { BufferGeometry, Mesh } from "three";
import type { Garment } from "./physkin.js";

/** The geometry of a garment: positions, normals and faces. `refresh` it after each step. */
export function garmentGeometry(garment: Garment): BufferGeometry;

/** Shows what the last step wrote. */
export function refresh(geometry: BufferGeometry): void;

/** Lays a mesh with attributes `_vertex` and, optionally, `_above` [m] on a garment. Returns what is to be called after
 * each step. */
export function layOn(mesh: Mesh, garment: Garment): () => void;
