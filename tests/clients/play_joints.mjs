// node play_joints.mjs MODULES FILE SECOND...: the bones that three.js makes of a glTF file without a mesh, as JSON: for
// each time the world position of each bone, and how many of them its helper draws.
import fs from "node:fs";
import path from "node:path";
import { pathToFileURL } from "node:url";

const [modules, file, ...times] = process.argv.slice(2);
const load = (name) => import(pathToFileURL(path.join(modules, name)).href);
const THREE = await load("three/build/three.module.js");
const { GLTFLoader } = await load("three/examples/jsm/loaders/GLTFLoader.js");

const content = fs.readFileSync(file);
const buffer = content.buffer.slice(content.byteOffset, content.byteOffset + content.byteLength);
const gltf = await new GLTFLoader().parseAsync(buffer, "");
const helper = new THREE.SkeletonHelper(gltf.scene);
const mixer = new THREE.AnimationMixer(gltf.scene);
const action = mixer.clipAction(gltf.animations[0]).setLoop(THREE.LoopOnce);
action.clampWhenFinished = true;
action.play();

const frames = times.map((time) => {
  mixer.setTime(Number(time));
  gltf.scene.updateMatrixWorld(true);
  const place = (bone) => [bone.name, bone.getWorldPosition(new THREE.Vector3()).toArray()];
  return Object.fromEntries(helper.bones.map(place));
});
console.log(JSON.stringify({ frames, clip: gltf.animations[0].name }));
