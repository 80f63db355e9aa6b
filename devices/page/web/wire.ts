// What travels between the server and this page: see docs/lab/page-messages.md.

export const VERSION = 1;

export interface StreamInfo {
  name: string;
  kind: "signal" | "events" | "frame" | "points" | "curves" | "mesh";
  shape: number[];
  rate_hz: number | null;
  channels: string[];
  units: string[];
  fields: [string, string, string][];
  describe: string;
  bones: [string | number, string | number][];
  faces: number[][] | null;
  /** Whether y points down and z away, as a camera has it. */
  down: boolean;
  columns: number | null;
  avatar: AvatarInfo | null;
}
/** A humanoid bone: its parent among the bones, the pose's joint (-1: it moves with its parent), and how it is turned (w, x, y, z) from the
 * T-pose to the skeleton's rest. */
export interface AvatarBone { bone: string; parent: number; joint: number; turn: [number, number, number, number] }
/** Of a stream of poses: the joints' parents, and the bones. */
export interface AvatarInfo { parents: number[]; bones: AvatarBone[] }
/** One thing that an answer shows: see `Shown` in stream/graph/page_options.py. */
export interface ShownInfo {
  of: string; field?: string; label?: string; unit?: string; decimals?: number; factor?: number; values?: Record<string, string>;
  where?: Record<string, Cell | Cell[]>; count?: boolean; above?: number; between?: string[]; since?: boolean; down_s?: number;
}
export interface PanelInfo {
  kind: string;
  of: string[];
  title?: string;
  wide?: number;
  tall?: number;
  window_s?: number;
  least?: number | null;
  most?: number | null;
  missing?: string[];
  folded?: boolean;
  show?: ShownInfo[];
}
export interface NodeInfo { name: string; use: string; kind: "source" | "operator" | "outlet" }
export interface ValueInfo { node: string; initial: number; least: number; most: number; unit: string }
export interface Hello {
  t: "hello";
  v: number;
  name: string;
  mode: "live" | "replay" | "recording";
  t0_ms: number;
  session: Record<string, string>;
  streams: StreamInfo[];
  nodes: NodeInfo[];
  edges: [string, string, string][];
  values: ValueInfo[];
  words?: string[];
  takes?: boolean;
  panels: PanelInfo[];
  length_s?: number; whole?: boolean;
  spans?: [number, number, number][];
  gaps?: [number, number][][];
  moments?: (number[] | null)[];
}
export interface SignalMessage { t: "signal"; s: number; n: number; w: number; thin: boolean; fresh: boolean }
/** A spectrum of all channels, or a spectrogram of one; without a whole window it has no bins. */
export interface SpectrumMessage {
  t: "spectrum" | "spectrogram";
  s: number; begin: number; end: number; channel: number; bins: number; bin_hz: number; windows: number; hop?: number;
}
export type Cell = string | number | boolean | null;
export interface EventsMessage { t: "events"; s: number; first: number; rows: Cell[][]; fresh: boolean }
export interface NewestMessage {
  t: "frame" | "points" | "curves" | "mesh";
  s: number; at: number; count: number; shape: number[]; type: "u2" | "f4"; low?: number[]; high?: number[];
}
export type Row = Record<string, string | number>;
export interface StateMessage {
  t: "state"; table: Record<string, Row>; clients: number; skipped: number; dropped: number; over: string; reports?: string[]; starting?: string;
  edges?: Record<string, number>;
}
export interface LogMessage { t: "log"; lines: { at: number; level: string; text: string }[] }
export interface ProgressMessage { t: "progress"; share: number; what: string }
export interface GapsMessage { t: "gaps"; s: number; gaps: [number, number][] }
export interface MomentsMessage { t: "moments"; s: number; at: number[] }
export interface LookedMessage { t: "looked"; at: number }
/** How far a replay is, of how much (s), and its speed; 0: it stands still. */
export interface PaceMessage { t: "pace"; at: number; length: number; speed: number }
export type Message = PaceMessage | SpectrumMessage | LookedMessage | GapsMessage | MomentsMessage | Hello | SignalMessage | EventsMessage | NewestMessage | StateMessage | LogMessage | ProgressMessage;

const text = new TextDecoder();

export function decode(buffer: ArrayBuffer): [Message, ArrayBuffer, number] {
  const length = new DataView(buffer).getUint32(0, true);
  return [JSON.parse(text.decode(new Uint8Array(buffer, 4, length))) as Message, buffer, 4 + length];
}

const FIRST_PAUSE_MS = 300;
const LONGEST_PAUSE_MS = 5000;

/** One WebSocket, opened again whenever it is lost. */
export class Connection {
  private socket: WebSocket | null = null;
  private pause = FIRST_PAUSE_MS;
  private closed = false;

  constructor(
    private hear: (message: Message, buffer: ArrayBuffer, at: number) => void, private state: (state: string) => void, private readonly path = "socket"
  ) {
    this.open();
  }

  ask(what: object): boolean {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(what));
    return true;
  }

  /** Leave, and do not come back. */
  close(): void {
    this.closed = true;
    this.socket?.close();
  }

  private open(): void {
    const url = new URL(this.path, location.href);
    url.protocol = url.protocol.replace("http", "ws");
    url.search = location.search;
    const socket = new WebSocket(url);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => { this.pause = FIRST_PAUSE_MS; this.state("connected"); };
    socket.onmessage = (event: MessageEvent<ArrayBuffer>) => this.hear(...decode(event.data));
    socket.onclose = () => {
      if (this.closed) return;
      this.state("not connected; trying again");
      setTimeout(() => this.open(), this.pause);
      this.pause = Math.min(2 * this.pause, LONGEST_PAUSE_MS);
    };
    this.socket = socket;
  }
}
