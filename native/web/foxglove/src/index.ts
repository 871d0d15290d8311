// Garments of a running ROS node in Foxglove's 3D panel: `~/mesh` once, then `~/garment_nodes`, 19 KB a frame in place of
// a cloud of 140. Show both topics of a garment: what does not change from frame to frame comes with the mesh.
import type { ExtensionContext, MessageEvent } from "@foxglove/extension";

// Fields of physkin_msgs that are read here; msg_defs/msg says what they are.
interface Header {
  stamp: { sec: number; nsec: number };
  frame_id: string;
}
interface GarmentMesh {
  revision: number;
  model_name: string;
  vertex_count: number;
  faces: Uint32Array;
  rest_vertices: Float32Array;
  node_count: number;
  node_rest: Float32Array;
  influences: number;
  influence_nodes: Uint32Array;
  influence_weights: Float32Array;
  detail_influences: number;
  detail_nodes: Uint32Array;
  detail_weights: Float32Array;
}
interface GarmentNodes {
  header: Header;
  revision: number;
  transforms: Float32Array;
  detail_offsets: Float32Array;
}
type Point = { x: number; y: number; z: number };

const COLOUR = { r: 0.62, g: 0.66, b: 0.74, a: 1 };
const ORIGIN = { position: { x: 0, y: 0, z: 0 }, orientation: { x: 0, y: 0, z: 0, w: 1 } };
const NOTHING = { deletions: [], entities: [] };

const meshes = new Map<string, GarmentMesh>(); // by what the topics of their garments are below

export function activate(context: ExtensionContext): void {
  context.registerMessageConverter({
    fromSchemaName: "physkin_msgs/msg/GarmentMesh",
    toSchemaName: "foxglove.SceneUpdate",
    converter: (mesh: GarmentMesh, event: Pick<MessageEvent, "topic">) => {
      meshes.set(garmentOf(event.topic), mesh);
      return NOTHING;
    },
  });
  context.registerMessageConverter({
    fromSchemaName: "physkin_msgs/msg/GarmentNodes",
    toSchemaName: "foxglove.SceneUpdate",
    converter: (nodes: GarmentNodes, event: Pick<MessageEvent, "topic">) => {
      const mesh = meshes.get(garmentOf(event.topic));
      return mesh?.revision === nodes.revision ? sceneOf(mesh, nodes, garmentOf(event.topic)) : NOTHING;
    },
  });
}

/** "/drape_node/tshirt" of "/drape_node/tshirt/mesh". */
const garmentOf = (topic: string) => topic.slice(0, topic.lastIndexOf("/"));

function sceneOf(mesh: GarmentMesh, { header, transforms, detail_offsets }: GarmentNodes, id: string) {
  const { stamp: timestamp, frame_id } = header;
  const triangles = { pose: ORIGIN, points: skinned(mesh, transforms, detail_offsets), color: COLOUR, colors: [] };
  const entity = { timestamp, frame_id, id, lifetime: { sec: 0, nsec: 0 }, frame_locked: true, metadata: [] };
  const none = { arrows: [], cubes: [], spheres: [], cylinders: [], lines: [], texts: [], models: [] };
  return { deletions: [], entities: [{ ...entity, ...none, triangles: [{ ...triangles, indices: mesh.faces }] }] };
}

/** Sum over garment nodes of weight * transform * (rest vertex + detail - node at rest). */
function skinned(mesh: GarmentMesh, transforms: Float32Array, offsets: Float32Array): Point[] {
  const matrices = Float32Array.from(transforms); // of the garment at rest, in place of each node's own frame
  for (let node = 0, row = 0; row < matrices.length; node = Math.floor((row += 4) / 12)) {
    for (let axis = 0; axis < 3; ++axis) matrices[row + 3]! -= matrices[row + axis]! * mesh.node_rest[3 * node + axis]!;
  }
  return Array.from({ length: mesh.vertex_count }, (_, vertex) => {
    let [x, y, z] = [0, 1, 2].map((axis) => mesh.rest_vertices[3 * vertex + axis]!) as [number, number, number];
    for (let at = vertex * mesh.detail_influences; at < (vertex + 1) * mesh.detail_influences; ++at) {
      const [weight, offset] = [mesh.detail_weights[at]!, 3 * mesh.detail_nodes[at]!];
      x += weight * offsets[offset]!;
      y += weight * offsets[offset + 1]!;
      z += weight * offsets[offset + 2]!;
    }
    const point = { x: 0, y: 0, z: 0 };
    for (let at = vertex * mesh.influences; at < (vertex + 1) * mesh.influences; ++at) {
      const [weight, m] = [mesh.influence_weights[at]!, 12 * mesh.influence_nodes[at]!];
      point.x += weight * (matrices[m]! * x + matrices[m + 1]! * y + matrices[m + 2]! * z + matrices[m + 3]!);
      point.y += weight * (matrices[m + 4]! * x + matrices[m + 5]! * y + matrices[m + 6]! * z + matrices[m + 7]!);
      point.z += weight * (matrices[m + 8]! * x + matrices[m + 9]! * y + matrices[m + 10]! * z + matrices[m + 11]!);
    }
    return point;
  });
}
