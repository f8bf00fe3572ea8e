// fbx.mjs RESULT EXPORTS: opens and animates scene.fbx with three.js.
import { readFileSync } from 'node:fs';
import { pathToFileURL } from 'node:url';

const [result, exports] = process.argv.slice(2);
const load = (path) => import(pathToFileURL(`${process.env.NODE_MODULES}/${path}`).href);
const json = (name) => JSON.parse(readFileSync(`${result}/${name}`, 'utf8'));
const fail = (why) => { console.log(`FAILED fbx: ${why}`); process.exit(1); };

const THREE = await load('three/build/three.module.js');
globalThis.self = globalThis.window = globalThis;
const { FBXLoader } = await load('three/examples/jsm/loaders/FBXLoader.js');
const bytes = readFileSync(`${exports}/scene.fbx`);
const scene = new FBXLoader().parse(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length), '');

const poses = json('poses3d.json');
const people = json('people.json').people;
const publish = json('manifest.json').publish;
const yUp = ([x, y, z]) => publish.up_axis === 'z' ? new THREE.Vector3(x, z, -y) : new THREE.Vector3(x, y, z);
// three.js drops the namespace's colon, since it addresses tracks by path.
const fingers = ['index', 'middle', 'pinky', 'ring', 'thumb'].flatMap((name) => [1, 2, 3].map((place) => `${name}${place}`));
const fingerNames = ['left', 'right'].flatMap((side) => fingers.map((name) => `${side}_${name}`));
const bones = ({ id, hands }) => [...poses.joint_names, ...(hands ? fingerNames : [])].map((name) => {
  const bone = scene.getObjectByName(THREE.PropertyBinding.sanitizeNodeName(`person_${id}:${name}`));
  return bone?.isBone ? bone : fail(`person ${id} has no bone ${name}`);
});

const meshes = [];
scene.traverse((node) => { if (node.isSkinnedMesh) meshes.push(node); });
if (meshes.length !== people.length) fail(`${meshes.length} skinned meshes`);
const mixer = new THREE.AnimationMixer(scene);
mixer.clipAction(scene.animations[0]).play();
const last = publish.frame_range[1] / publish.fps;
if (Math.abs(scene.animations[0].duration - last) > 1e-3) fail(`the animation ends at ${scene.animations[0].duration} s`);
let worst = 0;
for (const person of people) {
  const joints = bones(person);
  for (const frame of person.frames) {
    mixer.setTime(Math.min(frame / publish.fps, last - 1e-6)); // at its end the animation starts again
    scene.updateMatrixWorld(true);
    const t = frame - person.frames[0];
    const ends = person.hands ? [...person.hands.left.joints[t], ...person.hands.right.joints[t]] : [];
    [...poses.frames[frame][person.id], ...ends].forEach((joint, j) => {
      const place = new THREE.Vector3().setFromMatrixPosition(joints[j].matrixWorld).multiplyScalar(0.01);
      worst = Math.max(worst, place.distanceTo(yUp(joint)));
    });
  }
}
console.log(`${worst <= 0.5e-3 ? 'ok' : 'FAILED'} fbx: joints ${(1e3 * worst).toFixed(5)} mm`);
process.exit(worst <= 0.5e-3 ? 0 : 1);
