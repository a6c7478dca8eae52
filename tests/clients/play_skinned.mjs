// node play_skinned.mjs MODULES FILE SECOND...: vertices of a skinned glTF file in three.js at times of its first
// animation, its bones, and what three-vrm finds in it, as JSON.
import fs from "node:fs";
import path from "node:path";
import { pathToFileURL } from "node:url";

const [modules, file, ...times] = process.argv.slice(2);
const load = (name) => import(pathToFileURL(path.join(modules, name)).href);
const THREE = await load("three/build/three.module.js");
const { GLTFLoader } = await load("three/examples/jsm/loaders/GLTFLoader.js");
const { VRMLoaderPlugin } = await load("@pixiv/three-vrm/lib/three-vrm.module.js");

const warnings = [];
console.warn = (...words) => warnings.push(words.join(" "));
const content = fs.readFileSync(file);
const loader = new GLTFLoader();
loader.register((parser) => new VRMLoaderPlugin(parser));
const buffer = content.buffer.slice(content.byteOffset, content.byteOffset + content.byteLength);
const gltf = await loader.parseAsync(buffer, "");

const meshes = [];
gltf.scene.traverse((object) => object.isSkinnedMesh && meshes.push(object));
const mixer = new THREE.AnimationMixer(gltf.scene);
gltf.animations.slice(0, 1).forEach((clip) => mixer.clipAction(clip).play()); // as viewers do

function vertices() {
  gltf.scene.updateMatrixWorld(true);
  const found = [];
  const point = new THREE.Vector3();
  for (const mesh of meshes) {
    for (let i = 0; i < mesh.geometry.attributes.position.count; i++) {
      mesh.getVertexPosition(i, point).applyMatrix4(mesh.matrixWorld);
      found.push([point.x, point.y, point.z]);
    }
  }
  return found;
}

// What three-vrm's retargeting makes of a raised arm: the normalized bone turns, the bone of the file follows.
function raised(vrm) {
  const before = vrm.humanoid.getRawBoneNode("leftHand").getWorldPosition(new THREE.Vector3());
  vrm.humanoid.getNormalizedBoneNode("leftUpperArm").rotation.z = Math.PI / 2;
  vrm.update(0);
  gltf.scene.updateMatrixWorld(true);
  const after = vrm.humanoid.getRawBoneNode("leftHand").getWorldPosition(new THREE.Vector3());
  return { before: before.toArray(), after: after.toArray() };
}

const vrm = gltf.userData.vrm;
const report = { bones: meshes[0].skeleton.bones.map((bone) => bone.name), rest: vertices() };
report.vrm = vrm ? { bones: Object.keys(vrm.humanoid.humanBones), meta: vrm.meta.metaVersion, ...raised(vrm) } : null;
report.frames = times.map((time) => {
  mixer.setTime(Number(time));
  return vertices();
});
console.log(JSON.stringify({ ...report, warnings }));
