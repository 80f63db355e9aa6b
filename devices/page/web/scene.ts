// Points with names, skeletons and meshes in three dimensions; several streams stand in one scene.

import {
  AmbientLight, BufferAttribute, BufferGeometry, Color, DirectionalLight, DoubleSide, GridHelper, Group, LineBasicMaterial, LineSegments, type Material,
  Mesh, MeshStandardMaterial, type Object3D, PerspectiveCamera, Points, PointsMaterial, Scene, Sphere, Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

import { AvatarFigure } from "./avatar";
import { isFace, isFingers } from "./live_parts";
import { colour, make, type Page, Panel, shade, type Span } from "./panel";
import type { Newest, Stream } from "./store";
import type { PanelInfo } from "./wire";

const MOST_NAMES = 40;
/** Where a name stands beside its point, how high it is, and how wide each letter, in pixels. */
const [BESIDE, ABOVE, LINE, LETTER] = [6, 8, 13, 6.2];
const TO_METRES: Record<string, number> = { m: 1, cm: 0.01, mm: 0.001 };
const SKIN = 0x8fa8c8;
/** How far from the picture's middle what is shown may come, as a share of half the picture, before the view goes with it. */
const EDGE = 0.6;
/** What a key does to the view: to the side, upwards (radians), and how much nearer. */
const KEYS: Record<string, [number, number, number]> = {
  ArrowLeft: [-0.1, 0, 1], ArrowRight: [0.1, 0, 1], ArrowUp: [0, 0.1, 1], ArrowDown: [0, -0.1, 1], "+": [0, 0, 0.9], "-": [0, 0, 1 / 0.9],
};

interface Extent { centre: Vector3; radius: number }

/** What stands in a scene. */
interface Figure {
  readonly parts: Object3D[];
  readonly labels: HTMLElement[];
  readonly positions: Float32Array;
  /** Take what is newest; whether there is anything new. */
  take(): boolean;
  restyle(): void;
  leave?(): void;
}

/** One stream in the scene. Where a coordinate is missing, its point, its lines and its triangles are not drawn. */
class Drawn implements Figure {
  readonly parts: Object3D[] = [];
  readonly labels: HTMLElement[];
  positions = new Float32Array(0);
  private readonly geometry = new BufferGeometry();
  private readonly lines = new BufferGeometry();
  private readonly materials: [Material & { color: Color }, () => string][] = [];
  private readonly bones: [number, number][];
  private shown: Newest | null = null;

  constructor(private readonly stream: Stream, number: number, alone: boolean) {
    const { info } = stream;
    const place = (end: string | number) => (typeof end === "number" ? end : info.channels.indexOf(end));
    this.bones = info.bones.map(([a, b]): [number, number] => [place(a), place(b)]).filter(([a, b]) => a >= 0 && b >= 0);
    if (info.kind === "mesh") {
      this.geometry.setIndex(new BufferAttribute(Uint32Array.from((info.faces ?? []).flat()), 1));
      this.parts.push(new Mesh(this.geometry, new MeshStandardMaterial({ color: SKIN, side: DoubleSide, flatShading: true })));
    } else {
      this.parts.push(new Points(this.geometry, this.coloured(new PointsMaterial({ size: 7, sizeAttenuation: false }), () => (number ? shade(number) : colour("accent")))));
      this.parts.push(new LineSegments(this.lines, this.coloured(new LineBasicMaterial(), () => colour("dim"))));
    }
    for (const part of this.parts) part.frustumCulled = false;
    for (const geometry of [this.geometry, this.lines]) geometry.boundingSphere = new Sphere(); // of points that are missing none can be found
    const names = info.kind === "mesh" || !alone ? [] : info.channels.slice(0, MOST_NAMES);
    this.labels = names.map((name) => make("span", { class: "name", hidden: "" }, name));
  }

  restyle(): void {
    for (const [material, found] of this.materials) material.color = new Color(found());
  }

  /** Take what is newest; whether there is anything new. */
  take(): boolean {
    const { newest, info } = this.stream;
    if (!newest || newest === this.shown) return false;
    this.shown = newest;
    const scale = TO_METRES[info.units[0] ?? "m"] ?? 1;
    if (this.positions.length !== newest.data.length) this.positions = new Float32Array(newest.data.length);
    for (let i = 0; i < this.positions.length; i++) {
      const [raw, low] = [newest.data[i] as number, newest.low[i % 3]];
      const sign = info.down && i % 3 ? -1 : 1; // a camera's y points down and its z away: it is turned round
      this.positions[i] = sign * scale * (low === undefined ? raw : low + (raw * ((newest.high[i % 3] as number) - low)) / 65535);
    }
    const attribute = new BufferAttribute(this.positions, 3);
    this.geometry.setAttribute("position", attribute);
    this.lines.setAttribute("position", attribute);
    if (info.kind === "mesh") return true;
    const there = (i: number) => Number.isFinite(this.positions[3 * i]);
    this.geometry.setIndex([...Array(this.positions.length / 3).keys()].filter(there));
    this.lines.setIndex(this.bones.filter(([a, b]) => there(a) && there(b)).flat());
    return true;
  }

  private coloured<M extends Material & { color: Color }>(material: M, found: () => string): M {
    material.color = new Color(found());
    this.materials.push([material, found]);
    return material;
  }
}

export class ScenePanel extends Panel {
  private readonly scene = new Scene();
  private readonly camera = new PerspectiveCamera(40, 1, 0.01, 200);
  protected readonly figures: Figure[];
  private readonly up = make("button", { type: "button", "aria-pressed": "false" }, "z up");
  private renderer: WebGLRenderer | null = null;
  private controls: OrbitControls | null = null;
  private grid: GridHelper | null = null;
  /** Whether something else than the view has changed since it was drawn. */
  private changed = true;
  /** Whether somebody has chosen what to look at. */
  private chosen = false;

  constructor(info: PanelInfo, streams: Stream[], page: Page) {
    super(info, streams, page);
    this.body.style.minHeight = this.tall;
    this.figures = streams.map((stream, i) => this.figure(stream, i));
    this.up.onclick = () => {
      this.up.setAttribute("aria-pressed", String(this.up.getAttribute("aria-pressed") !== "true"));
      this.look();
    };
    try {
      this.begin();
    } catch (error) {
      this.note.textContent = `no 3-D here: ${String(error)}`;
    }
  }

  protected figure(stream: Stream, number: number): Figure {
    return new Drawn(stream, number, this.streams.length === 1);
  }

  /** As tall as asked for, but no taller than the screen below the answer: whoever moves is seen from head to foot. */
  private get tall(): string {
    return `min(${this.height * 1.2}px, max(18rem, 100vh - 18.5rem))`;
  }

  /** From where it is looked at first. */
  protected get from(): Vector3 {
    return new Vector3(0.5, 0.35, 0.8);
  }

  private begin(): void {
    const renderer = new WebGLRenderer({ antialias: true, alpha: true, preserveDrawingBuffer: true });
    renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
    this.renderer = renderer;
    if (this.info.kind !== "avatar") this.tools.append(this.up); // a pose says which way is up
    this.body.append(renderer.domElement);
    renderer.domElement.setAttribute("aria-label", "three-dimensional view; drag turns it, so do Shift and the arrows; plus and minus bring it near and far");
    const sun = new DirectionalLight(0xffffff, 2);
    sun.position.set(0.4, 1, 0.7);
    this.scene.add(new AmbientLight(0xffffff, 0.9), sun);
    this.controls = new OrbitControls(this.camera, renderer.domElement);
    this.controls.addEventListener("start", () => { this.chosen = true; });
    for (const figure of this.figures) {
      this.scene.add(...figure.parts);
      for (const label of figure.labels) this.body.append(label);
    }
  }

  override leave(): void {
    for (const figure of this.figures) figure.leave?.();
    this.controls?.dispose();
    this.renderer?.dispose();
    this.renderer?.forceContextLoss();
    this.renderer = null;
  }

  override resize(): void {
    this.body.style.minHeight = this.tall;
    super.resize();
  }

  override restyle(): void {
    for (const figure of this.figures) figure.restyle();
    this.changed = true;
    this.look();
  }

  protected override key({ key, shiftKey }: KeyboardEvent): boolean {
    const turn = KEYS[key];
    if (!turn || !this.controls || (key.startsWith("Arrow") && !shiftKey)) return false;
    const [side, up, nearer] = turn;
    this.chosen = true;
    const from = this.camera.position.clone().sub(this.controls.target);
    from.applyAxisAngle(this.camera.up, side).applyAxisAngle(this.camera.up.clone().cross(from).normalize(), -up).multiplyScalar(nearer);
    if (Math.abs(from.clone().normalize().dot(this.camera.up)) < 0.99) this.camera.position.copy(this.controls.target).add(from);
    return true;
  }

  draw(_span: Span): void {
    const { renderer, controls } = this;
    if (!renderer || !controls) return;
    const news = this.figures.map((figure) => figure.take()).some((taken) => taken);
    if (news) {
      this.changed = true;
      if (!this.grid) this.look();
      else if (!this.chosen) this.follow();
      const points = this.figures.reduce((n, f) => n + f.positions.length / 3, 0);
      this.element.dataset["points"] = String(points);
    }
    if (!this.grid) return;
    const { clientWidth, clientHeight } = this.body;
    if (renderer.domElement.clientWidth !== clientWidth || renderer.domElement.clientHeight !== clientHeight) {
      renderer.setSize(clientWidth, clientHeight);
      this.camera.aspect = clientWidth / clientHeight;
      this.camera.updateProjectionMatrix();
      this.changed = true;
    }
    if (!controls.update() && !this.changed) return;
    this.changed = false;
    renderer.render(this.scene, this.camera);
    for (const figure of this.figures) this.label(figure, clientWidth, clientHeight);
    this.stamp();
  }

  /** Look at all of it. */
  private look(): void {
    const extent = extentOf(this.figures);
    if (!extent || !this.controls) return;
    const { centre, radius } = extent;
    this.chosen = false;
    const zUp = this.up.getAttribute("aria-pressed") === "true";
    this.camera.up.set(0, zUp ? 0 : 1, zUp ? 1 : 0);
    const from = zUp ? new Vector3(0.5, -0.8, 0.35) : this.from;
    this.controls.target.copy(centre);
    this.camera.position.copy(centre).add(from.normalize().multiplyScalar(3 * radius));
    this.camera.near = radius / 30;
    this.camera.far = radius * 300;
    this.camera.updateProjectionMatrix();
    if (this.grid) this.scene.remove(this.grid);
    this.grid = new GridHelper(radius * 4, 8, colour("dim"), colour("rule"));
    this.grid.position.copy(centre);
    this.grid.visible = !document.body.classList.contains("alone");
    if (zUp) {
      this.grid.rotation.x = Math.PI / 2;
      this.grid.position.z -= radius;
    } else this.grid.position.y -= radius;
    this.scene.add(this.grid);
    this.changed = true;
  }

  /** Where what is shown leaves the picture, the view goes with it, from the same direction and as far away. */
  private follow(): void {
    const { camera, controls, grid } = this;
    const extent = extentOf(this.figures);
    if (!extent || !controls || !grid) return;
    const seen = extent.centre.clone().project(camera);
    if (seen.z < 1 && Math.max(Math.abs(seen.x), Math.abs(seen.y)) < EDGE) return;
    const way = extent.centre.clone().sub(controls.target);
    camera.position.add(way);
    controls.target.add(way);
    grid.position.add(way.addScaledVector(camera.up, -way.dot(camera.up)));
  }

  /** Names stand to the right of their points; where that is taken, to the left; where both are, the one that was there before stays. */
  private label({ labels, positions }: Figure, width: number, height: number): void {
    const at = new Vector3();
    const places = labels.map((label, i) => {
      at.fromArray(positions, 3 * i).project(this.camera);
      label.hidden = !Number.isFinite(at.x) || at.z > 1;
      const [x, y] = [((at.x + 1) * width) / 2 + BESIDE, ((1 - at.y) * height) / 2 - ABOVE];
      if (!label.hidden) label.style.transform = `translate(${x}px, ${y}px)`;
      return { label, x, y, wide: LETTER * (label.textContent?.length ?? 0) };
    }).filter(({ label }) => !label.hidden);
    const stood = (label: HTMLElement) => Number(label.classList.contains("crowded"));
    const taken: { x: number; y: number; wide: number }[] = [];
    for (const { label, x, y, wide } of places.sort((a, b) => stood(a.label) - stood(b.label))) {
      const free = (from: number) => !taken.some((other) => Math.abs(y - other.y) < LINE && from < other.x + other.wide && other.x < from + wide);
      const sides = [x, x - 2 * BESIDE - wide];
      const side = label.classList.contains("left") && free(sides[1] as number) ? 1 : sides.findIndex(free);
      label.classList.toggle("left", side === 1);
      label.classList.toggle("crowded", side < 0);
      if (side >= 0) taken.push({ x: sides[side] as number, y, wide });
    }
    this.element.dataset["names"] = String(taken.length);
  }
}

/** What the avatar itself shows: nothing of its own is drawn. */
const nothing = (): Figure => ({ parts: [new Group()], labels: [], positions: new Float32Array(0), restyle: () => {}, take: () => false });

/** Avatars that follow streams of poses, with fingers and face; other streams stand beside them. */
export class AvatarPanel extends ScenePanel {
  protected override figure(stream: Stream, number: number): Figure {
    const { avatar } = stream.info;
    if (isFingers(stream) || isFace(stream)) return nothing();
    return avatar ? new AvatarFigure(stream, avatar, (text) => { this.note.textContent = text; }, this.streams) : super.figure(stream, number);
  }

  protected override get from(): Vector3 {
    return new Vector3(0.2, 0.1, 1);
  }

  override draw(span: Span): void {
    super.draw(span);
    const first = this.figures.find((figure) => figure instanceof AvatarFigure);
    const at = ["leftHand", "rightHand", "head"].map((bone) => first?.place(bone).map((v) => v.toFixed(3)).join(" "));
    if (at[0]) this.element.dataset["bones"] = at.join(", ");
    const tip = first?.place("leftIndexDistal") ?? [];
    if (tip.length) this.element.dataset["live"] = [...tip, first?.shows("blinkLeft"), first?.shows("aa")].map((v) => v?.toFixed(3)).join(" ");
  }
}

/** The middle of all points that are there, and how far they reach from it; null without any. */
function extentOf(figures: Figure[]): Extent | null {
  const [low, high] = [new Vector3(Infinity, Infinity, Infinity), new Vector3(-Infinity, -Infinity, -Infinity)];
  const point = new Vector3();
  for (const { positions } of figures) {
    for (let i = 0; i < positions.length; i += 3) {
      if (!Number.isFinite(positions[i])) continue;
      point.fromArray(positions, i);
      low.min(point);
      high.max(point);
    }
  }
  if (low.x > high.x) return null;
  const radius = high.distanceTo(low) / 2;
  return { centre: low.add(high).multiplyScalar(0.5), radius: Math.max(radius, 1e-3) };
}
