// Writes three.glb, a skinned mesh that morphs beside one that moves, by three.js; and into three.json where its vertices are, as three.js has them.
import * as THREE from 'three';
import { GLTFExporter } from 'three/examples/jsm/exporters/GLTFExporter.js';
import fs from 'fs';

globalThis.FileReader = class {
  readAsArrayBuffer(blob) { blob.arrayBuffer().then(data => { this.result = data; this.onloadend(); }); }
};
const geometry = new THREE.BoxGeometry(0.4, 1, 0.4, 1, 2, 1);
const place = geometry.attributes.position, count = place.count;
const bones = new Uint16Array(4 * count), shares = new Float32Array(4 * count), wide = new Float32Array(3 * count);
for (let v = 0; v < count; v++) {
  const high = place.getY(v) + 0.5;
  bones.set([0, 1, 0, 0], 4 * v);
  shares.set([1 - high, high, 0, 0], 4 * v);
  wide.set([0.3 * place.getX(v), 0.1, -0.2 * place.getZ(v)], 3 * v);
}
geometry.setAttribute('skinIndex', new THREE.BufferAttribute(bones, 4));
geometry.setAttribute('skinWeight', new THREE.BufferAttribute(shares, 4));
geometry.morphAttributes.position = [new THREE.BufferAttribute(wide, 3)];
geometry.morphTargetsRelative = true;
const skinned = new THREE.SkinnedMesh(geometry, new THREE.MeshStandardMaterial());
const low = new THREE.Bone(), high = new THREE.Bone();
low.name = 'low'; high.name = 'high'; skinned.name = 'skinned';
low.position.y = -0.5; high.position.y = 0.5;
low.add(high);
skinned.add(low);
skinned.bind(new THREE.Skeleton([low, high]));
const box = new THREE.Mesh(new THREE.BoxGeometry(0.2, 0.2, 0.2), new THREE.MeshStandardMaterial());
box.name = 'box';
const stand = new THREE.Group();
stand.name = 'stand'; stand.scale.set(1, 2, 1); stand.position.set(1, 0, 0.5);
stand.add(box);
const scene = new THREE.Scene();
scene.add(skinned, stand);
const times = [0, 0.25, 0.5, 0.75, 1];
const turn = a => new THREE.Quaternion().setFromEuler(new THREE.Euler(a, 0.3 * a, 0)).toArray();
const clip = (name, size, way) => new THREE.AnimationClip(name, 1, [
  new THREE.QuaternionKeyframeTrack('high.quaternion', times, times.flatMap(t => turn(size * t))),
  new THREE.NumberKeyframeTrack('skinned.morphTargetInfluences[wide]', times, times.map(t => size * t * t), way),
  new THREE.VectorKeyframeTrack('stand.position', times, times.flatMap(t => [1 + t, size * t, 0.5]), way),
  new THREE.VectorKeyframeTrack('box.scale', times, times.flatMap(t => [1, 1 + t, 1])),
]);
skinned.morphTargetDictionary = { wide: 0 };
skinned.morphTargetInfluences = [0];
const clips = [clip('bend it', 1.2, THREE.InterpolateLinear), clip('leap', -0.7, THREE.InterpolateDiscrete)];
const frames = {};
for (const one of clips) {
  const mixer = new THREE.AnimationMixer(scene), action = mixer.clipAction(one);
  action.clampWhenFinished = true; action.setLoop(THREE.LoopOnce, 1); action.play();
  frames[one.name] = [];
  for (let k = 0; k <= 8; k++) {
    mixer.setTime(k / 8);
    scene.updateMatrixWorld(true);
    const points = [];
    for (const mesh of [skinned, box]) {
      for (let v = 0; v < mesh.geometry.attributes.position.count; v++) {
        points.push(mesh.getVertexPosition(v, new THREE.Vector3()).applyMatrix4(mesh.matrixWorld).toArray());
      }
    }
    frames[one.name].push(points);
  }
  mixer.stopAllAction();
}
new GLTFExporter().parse(scene, made => {
  fs.writeFileSync('three.glb', Buffer.from(made));
  fs.writeFileSync('three.json', JSON.stringify(frames));
}, error => { throw error; }, { binary: true, animations: clips });
