// An avatar (VRM 0.x or 1.0) that follows a stream of poses: the file that the server was told to show, or the one that comes with it.

import { type VRM, type VRMHumanBoneName, VRMLoaderPlugin, VRMUtils } from "@pixiv/three-vrm";
import { Group, Quaternion, TextureLoader, Vector3 } from "three";
import { GLTFLoader } from "three/addons/loaders/GLTFLoader.js";

import { bendFingers, isFace, isFingers, moveFace } from "./live_parts";
import type { Newest, Stream } from "./store";
import type { AvatarBone, AvatarInfo } from "./wire";

const FILE = "avatar.vrm";
const LEG = ["leftUpperLeg", "leftLowerLeg", "leftFoot"] as const;
/** So far above the head's joint there may be hair or ears. */
const CROWN_M = 0.25;
/** From the legs to the head's joint of most bodies: whoever squats when the panel opens is seen whole when they stand up. */
const TRUNK_M = 0.7;
const LONGEST_STEP_S = 0.1;

/** Turns by half a circle about the vertical axis: avatars of VRM 0.x face the other way. */
const aboutFace = (q: Quaternion): Quaternion => q.set(-q.x, q.y, -q.z, q.w);

/** A figure of a scene: bones turn as the pose's joints do, and the hips move as far as its legs are long. */
export class AvatarFigure {
  private readonly group = new Group();
  readonly parts = [this.group];
  readonly labels: HTMLElement[] = [];
  positions = new Float32Array(0);
  private vrm: VRM | null = null;
  private shown: Newest | null = null;
  private before = NaN;
  private readonly joints: Quaternion[];
  private readonly world: Quaternion[];
  private readonly turns: Quaternion[];

  /** `beside`: streams of the same panel, of which fingers and face are shown. */
  constructor(private readonly stream: Stream, private readonly info: AvatarInfo, private readonly say: (text: string) => void,
    private readonly beside: Stream[] = []) {
    this.joints = info.parents.map(() => new Quaternion());
    this.world = info.bones.map(() => new Quaternion());
    this.turns = info.bones.map(({ turn: [w, x, y, z] }) => new Quaternion(x, y, z, w));
    void this.load();
  }

  private async load(): Promise<void> {
    const loader = new GLTFLoader();
    loader.register((parser) => {
      parser.textureLoader = new TextureLoader(parser.options.manager); // pictures are elements: nothing is fetched from a blob
      return new VRMLoaderPlugin(parser);
    });
    try {
      this.say("the avatar is being loaded");
      const vrm = (await loader.loadAsync(FILE)).userData["vrm"] as VRM;
      VRMUtils.removeUnnecessaryVertices(vrm.scene);
      VRMUtils.rotateVRM0(vrm);
      vrm.scene.traverse((part) => { part.frustumCulled = false; });
      this.group.add(vrm.scene);
      this.vrm = vrm;
      this.shown = null;
      this.say("");
    } catch (error) {
      this.say(`the avatar cannot be shown: ${String(error)}`);
    }
  }

  restyle(): void {}

  /** Take what is newest; whether there is anything new. A pose that is not whole leaves the avatar as it is. */
  take(): boolean {
    const { newest } = this.stream;
    const { vrm } = this;
    if (!vrm || !newest || newest === this.shown) return false;
    this.shown = newest;
    if (![...newest.data, ...newest.turns].every(Number.isFinite)) return false;
    this.turn(newest.turns);
    const old = vrm.meta.metaVersion === "0";
    this.info.bones.forEach((bone, b) => {
      const node = vrm.humanoid.getNormalizedBoneNode(bone.bone as VRMHumanBoneName);
      if (!node) return;
      const above = this.above(vrm, bone);
      node.quaternion.copy(this.world[b] as Quaternion);
      if (above) node.quaternion.premultiply(above.clone().invert());
      if (old) aboutFace(node.quaternion);
    });
    for (const other of this.beside) {
      if (isFingers(other)) bendFingers(vrm, other, newest.at, old);
      else if (isFace(other)) moveFace(vrm, other, newest.at);
    }
    this.stand(vrm, newest, old);
    const step = Math.min(LONGEST_STEP_S, Math.max(0, newest.at - this.before) || 0);
    this.before = newest.at;
    vrm.update(step);
    return true;
  }

  /** World rotations of the joints, then of the bones. */
  private turn(numbers: Float32Array): void {
    this.info.parents.forEach((parent, j) => {
      const [w, x, y, z] = numbers.subarray(4 * j, 4 * j + 4) as unknown as [number, number, number, number];
      const joint = (this.joints[j] as Quaternion).set(x, y, z, w);
      if (parent >= 0) joint.premultiply(this.joints[parent] as Quaternion);
    });
    this.info.bones.forEach(({ joint, parent }, b) => {
      const world = this.world[b] as Quaternion;
      const above = (joint >= 0 ? this.joints[joint] : this.world[parent]) as Quaternion;
      world.multiplyQuaternions(above, this.turns[b] as Quaternion);
    });
  }

  /** How the nearest bone above is turned that the avatar has. */
  private above(vrm: VRM, { parent }: AvatarBone): Quaternion | null {
    for (let p = parent; p >= 0; p = (this.info.bones[p] as AvatarBone).parent) {
      if (vrm.humanoid.getNormalizedBoneNode((this.info.bones[p] as AvatarBone).bone as VRMHumanBoneName)) return this.world[p] as Quaternion;
    }
    return null;
  }

  /** The hips' place, and how far the avatar reaches. */
  private stand(vrm: VRM, newest: Newest, old: boolean): void {
    const joint = (name: string) => this.info.bones.find(({ bone }) => bone === name)?.joint ?? -1;
    const place = (name: string) => new Vector3().fromArray(newest.data, 3 * joint(name));
    const [thigh, shin] = [place(LEG[0]).distanceTo(place(LEG[1])), place(LEG[1]).distanceTo(place(LEG[2]))];
    const scale = joint(LEG[2]) >= 0 && thigh + shin > 0 ? legOf(vrm) / (thigh + shin) : 1;
    const hips = place("hips").multiplyScalar(scale);
    const head = place("head").multiplyScalar(scale);
    const standing = Math.max(head.y, legOf(vrm) + TRUNK_M) + CROWN_M;
    this.positions = Float32Array.of(...Array.from(newest.data, (value) => value * scale), head.x, standing, head.z);
    vrm.humanoid.getNormalizedBoneNode("hips")?.position.set(old ? -hips.x : hips.x, hips.y, old ? -hips.z : hips.z);
  }

  /** Where a bone of the avatar is (m). */
  place(bone: string): number[] {
    return this.vrm?.humanoid.getRawBoneNode(bone as VRMHumanBoneName)?.getWorldPosition(new Vector3()).toArray() ?? [];
  }

  /** How much of an expression is shown. */
  shows(expression: string): number {
    return this.vrm?.expressionManager?.getValue(expression) ?? NaN;
  }

  leave(): void {
    if (this.vrm) VRMUtils.deepDispose(this.vrm.scene);
  }
}

/** The length of the avatar's leg at rest (m). */
function legOf(vrm: VRM): number {
  const part = (name: "leftLowerLeg" | "leftFoot") => vrm.humanoid.normalizedRestPose[name]?.position ?? [0, 0, 0];
  return [part("leftLowerLeg"), part("leftFoot")].reduce((sum, at) => sum + Math.hypot(...at), 0);
}
