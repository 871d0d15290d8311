// Garments as three.js draws them.
import { BufferAttribute, BufferGeometry, DynamicDrawUsage } from "three";

const ROOM = 2; // times the radius of cloth at rest, for raised arms and legs

/** The geometry of a garment: positions, normals and faces. `refresh` it after each step. Its bounding sphere has room for
 * every pose. */
export function garmentGeometry(garment) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", written(garment.positions));
  geometry.setAttribute("normal", written(garment.normals));
  geometry.setIndex(new BufferAttribute(garment.faces, 1));
  geometry.computeBoundingSphere();
  geometry.boundingSphere.radius *= ROOM;
  return geometry;
}

/** Shows what the last step wrote. */
export function refresh(geometry) {
  geometry.attributes.position.needsUpdate = true;
  geometry.attributes.normal.needsUpdate = true;
}

/** Lays a mesh on a garment: each of its vertices is the garment's vertex that the attribute `_vertex` names, raised along
 * the normal by `_above` [m], if there is one. So are meshes of `physkin export --web`, whose textures need vertices
 * twice at seams, and whose stitches lie above the cloth. Returns what is to be called after each step. */
export function layOn(mesh, garment) {
  const { geometry } = mesh;
  const from = geometry.attributes._vertex.array;
  const above = geometry.attributes._above?.array ?? new Float32Array(from.length);
  const [positions, normals] = [new Float32Array(3 * from.length), new Float32Array(3 * from.length)];
  geometry.setAttribute("position", written(positions));
  geometry.setAttribute("normal", written(normals));
  mesh.frustumCulled = false;
  return () => {
    for (let vertex = 0, to = 0; vertex < from.length; ++vertex) {
      const side = above[vertex] < 0 ? -1 : 1; // what is turned up looks the other way
      for (let at = 3 * from[vertex], end = at + 3; at < end; ++at, ++to) {
        positions[to] = garment.positions[at] + above[vertex] * garment.normals[at];
        normals[to] = side * garment.normals[at];
      }
    }
    refresh(geometry);
  };
}

function written(array) {
  return new BufferAttribute(array, 3).setUsage(DynamicDrawUsage);
}
