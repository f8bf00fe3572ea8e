// gltf.mjs RESULT EXPORTS: checks scene.glb with Khronos's validator, then opens and animates it with three.js.
import { readFileSync } from 'node:fs';
import { pathToFileURL } from 'node:url';

const [result, exports] = process.argv.slice(2);
const modules = process.env.NODE_MODULES;
const load = (path) => import(pathToFileURL(`${modules}/${path}`).href);
const json = (name) => JSON.parse(readFileSync(`${result}/${name}`, 'utf8'));
const fail = (why) => { console.log(`FAILED gltf: ${why}`); process.exit(1); };

const bytes = new Uint8Array(readFileSync(`${exports}/scene.glb`));
const validator = (await load('gltf-validator/index.js')).default;
const report = await validator.validateBytes(bytes, { maxIssues: 0 });
const { numErrors, numWarnings } = report.issues;
if (numErrors || numWarnings) fail(JSON.stringify(report.issues.messages.slice(0, 5)));

const THREE = await load('three/build/three.module.js');
globalThis.self = globalThis;
const { GLTFLoader } = await load('three/examples/jsm/loaders/GLTFLoader.js');
const gltf = await new Promise((done, failed) => new GLTFLoader().parse(bytes.buffer, '', done, failed));

const poses = json('poses3d.json');
const people = json('people.json');
const cameras = json('cameras.json').cameras.filter((camera) => camera.status === 'solved');
const publish = json('manifest.json').publish;
const yUp = ([x, y, z]) => publish.up_axis === 'z' ? new THREE.Vector3(x, z, -y) : new THREE.Vector3(x, y, z);

const mixer = new THREE.AnimationMixer(gltf.scene);
mixer.clipAction(gltf.animations[0]).play();
const skins = gltf.scene.children.filter((node) => node.isSkinnedMesh);
if (skins.length !== people.people.length) fail(`${skins.length} skins`);
const { vertices, people: skin } = json('vertices.json');
const seconds = (publish.frame_range[1] - publish.frame_range[0]) / publish.fps;
if (Math.abs(gltf.animations[0].duration - seconds) > 1e-4) fail(`the animation lasts ${gltf.animations[0].duration} s`);
let worstJoint = 0;
let worstVertex = 0;
let worstPixel = 0;
for (const [i, person] of people.people.entries()) {
  const bones = skins[i].skeleton.bones;
  for (const frame of person.frames) {
    // At its end the animation starts again.
    mixer.setTime(Math.min((frame - publish.frame_range[0]) / publish.fps, gltf.animations[0].duration - 1e-6));
    gltf.scene.updateMatrixWorld(true);
    const t = frame - person.frames[0];
    const fingers = person.hands ? [...person.hands.left.joints[t], ...person.hands.right.joints[t]] : [];
    const joints = [...poses.frames[frame][person.id], ...fingers];
    if (bones.length !== joints.length) fail(`${bones.length} bones`);
    joints.forEach((joint, j) => {
      const place = new THREE.Vector3().setFromMatrixPosition(bones[j].matrixWorld);
      worstJoint = Math.max(worstJoint, place.distanceTo(yUp(joint)));
    });
    skin[person.id][frame]?.forEach((vertex, v) => {
      const place = skins[i].localToWorld(skins[i].getVertexPosition(vertices[v], new THREE.Vector3()));
      worstVertex = Math.max(worstVertex, place.distanceTo(yUp(vertex)));
    });
  }
}
for (const [i, camera] of cameras.entries()) {
  const theirs = gltf.cameras[i];
  theirs.updateMatrixWorld(true);
  theirs.updateProjectionMatrix();
  const { K, R, t, width, height } = camera;
  for (const frame of Object.values(poses.frames)) {
    for (const joint of Object.values(frame).flat()) {
      const p = R.map((row, r) => row[0] * joint[0] + row[1] * joint[1] + row[2] * joint[2] + t[r]);
      if (p[2] < 0.1) continue;
      // A glTF camera has a central principal point and no distortion.
      const ours = [K[0][0] * p[0] / p[2] + (width - 1) / 2, K[1][1] * p[1] / p[2] + (height - 1) / 2];
      const seen = yUp(joint).project(theirs);
      const pixel = [(seen.x + 1) / 2 * width - 0.5, (1 - seen.y) / 2 * height - 0.5];
      worstPixel = Math.max(worstPixel, Math.hypot(pixel[0] - ours[0], pixel[1] - ours[1]));
    }
  }
}
const good = worstJoint <= 0.5e-3 && worstVertex <= 1e-3 && worstPixel <= 0.1;
const lengths = `joints ${(1e3 * worstJoint).toFixed(5)} mm, vertices ${(1e3 * worstVertex).toFixed(5)} mm`;
const figures = `${numErrors} errors, ${lengths}, ${worstPixel.toFixed(6)} px`;
console.log(`${good ? 'ok' : 'FAILED'} gltf: ${figures}`);
process.exit(good ? 0 : 1);
