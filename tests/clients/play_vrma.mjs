// node play_vrma.mjs MODULES AVATAR ANIMATION SECOND...: what @pixiv/three-vrm-animation makes of a VRM animation on an
// avatar, as JSON: for each time the world rotation (xyzw) of each bone, the position of the hips, and the morph weights
// of each mesh. With "-" for ANIMATION, the avatar's own glTF animation is played.
import fs from "node:fs";
import path from "node:path";
import { pathToFileURL } from "node:url";

const [modules, avatar, animation, ...times] = process.argv.slice(2);
const load = (name) => import(pathToFileURL(path.join(modules, name)).href);
const THREE = await load("three/build/three.module.js");
const { GLTFLoader } = await load("three/examples/jsm/loaders/GLTFLoader.js");
const { VRMLoaderPlugin } = await load("@pixiv/three-vrm/lib/three-vrm.module.js");
const vrma = await load("@pixiv/three-vrm-animation/lib/three-vrm-animation.module.js");

const warnings = [];
console.warn = (...words) => warnings.push(words.join(" "));
const loader = new GLTFLoader();
loader.register((parser) => new VRMLoaderPlugin(parser));
loader.register((parser) => new vrma.VRMAnimationLoaderPlugin(parser));

async function read(file) {
  const content = fs.readFileSync(file);
  return loader.parseAsync(content.buffer.slice(content.byteOffset, content.byteOffset + content.byteLength), "");
}

const gltf = await read(avatar);
const vrm = gltf.userData.vrm;
const own = animation === "-";
const mixer = new THREE.AnimationMixer(gltf.scene);
let found = 1;
if (own) {
  mixer.clipAction(gltf.animations[0]).play();
} else {
  const animations = (await read(animation)).userData.vrmAnimations;
  found = animations.length;
  mixer.clipAction(vrma.createVRMAnimationClip(animations[0], vrm)).play();
}

const frames = times.map((time) => {
  mixer.setTime(Number(time));
  if (!own) {
    vrm.update(0);
  }
  gltf.scene.updateMatrixWorld(true);
  const bones = {};
  for (const name of Object.keys(vrm.humanoid.humanBones)) {
    const node = vrm.humanoid.getRawBoneNode(name);
    bones[name] = node.getWorldQuaternion(new THREE.Quaternion()).toArray();
  }
  const hips = vrm.humanoid.getRawBoneNode("hips").getWorldPosition(new THREE.Vector3()).toArray();
  const weights = [];
  gltf.scene.traverse((object) => object.isMesh && weights.push([...(object.morphTargetInfluences ?? [])]));
  return { bones, hips, weights };
});
console.log(JSON.stringify({ frames, animations: found, meta: vrm.meta.metaVersion, warnings }));
