// Overlay of a camera view: detections, the reprojected body and the distances between them.

import { type CameraDetections, changesOf, sourceOf } from '../data/detections'
import { type Motion, N_JOINTS, forEachFingerBone, keypointEdges, rowAt } from '../data/motion'
import { project } from '../data/projection'
import { errorColor, personColor } from './palette'
import type { Rectangle } from './stage'

export interface OverlayLook {
  detections: boolean
  body: boolean
  residuals: boolean
  selected: number | null
}

/** Raw detections with identities from tracking, or detections after the consistency stage. */
export type Side = 'raw' | 'denoised'

/** Counts and reprojection errors of one overlay picture. */
export interface OverlayStatistics {
  n_detections: number
  n_rejected: number
  n_repaired: number
  distances: number[]
}

/** Points below this confidence (of 255) are not connected by lines. */
const MIN_CONFIDENCE = 26

const REJECTED = '#ff5d62'
const WHITE = '#ffffff'

export class Overlay {
  readonly canvas: HTMLCanvasElement = document.createElement('canvas')
  private readonly context = this.canvas.getContext('2d')!
  private readonly edges: [number, number][]
  private readonly pixel: [number, number] = [0, 0]
  private readonly ratio = Math.min(devicePixelRatio, 2)
  /** Image pixels per screen pixel. */
  private scale = 1

  constructor(private readonly motion: Motion) {
    this.canvas.className = 'overlay'
    this.canvas.setAttribute('aria-hidden', 'true')
    this.edges = keypointEdges(motion.keypoint_names)
  }

  clear() {
    this.canvas.hidden = true
  }

  /** Clears the overlay and sets its size, CSS pixels. */
  begin(width: number, height: number) {
    const size = { width: Math.round(width * this.ratio), height: Math.round(height * this.ratio) }
    this.canvas.hidden = false
    if (this.canvas.width !== size.width || this.canvas.height !== size.height) Object.assign(this.canvas, size)
    this.context.setTransform(1, 0, 0, 1, 0, 0)
    this.context.clearRect(0, 0, size.width, size.height)
  }

  /** Draws a frame of a camera into a rectangle of the stage. */
  show(part: Rectangle, side: Side, view: number, frame: number, detections: CameraDetections | null, look: OverlayLook): OverlayStatistics {
    const statistics: OverlayStatistics = { n_detections: 0, n_rejected: 0, n_repaired: 0, distances: [] }
    this.context.save()
    this.enter(part, view)
    this.motion.people.forEach((_, index) => {
      if (look.body && isShown(look, index)) this.drawBody(index, view, frame)
    })
    if (detections) this.drawDetections(detections, side, view, frame, look, statistics)
    this.context.restore()
    return statistics
  }

  /** Sets the transform: one unit is one image pixel, and (0, 0) is the centre of the first pixel. */
  private enter(part: Rectangle, view: number) {
    const { context, ratio } = this
    this.scale = this.motion.cameras[view].width / part.width
    const zoom = ratio / this.scale
    context.setTransform(zoom, 0, 0, zoom, part.left * ratio + zoom / 2, part.top * ratio + zoom / 2)
    context.beginPath()
    context.rect(-0.5, -0.5, this.motion.cameras[view].width, this.motion.cameras[view].height)
    this.pen('#7d8b99', 1, 0.5)
    context.stroke()
    context.clip()
    context.lineCap = 'round'
  }

  private drawBody(index: number, view: number, frame: number) {
    const pixels = projectedJoints(this.motion, view, frame, index)
    if (!pixels) return
    const fingers = projectedFingers(this.motion, view, frame, index)
    this.pen('#0b0f14', 4.6, 0.55)
    this.strokeBones(pixels)
    this.pen(personColor(index), 2.4, 1)
    this.strokeBones(pixels)
    if (fingers.length === 0) return
    this.pen(personColor(index), 1.2, 1)
    this.strokeLines(fingers)
  }

  /** Draws lines of four numbers each, px. */
  private strokeLines(lines: [number, number, number, number][]) {
    const { context } = this
    context.beginPath()
    for (const [a, b, c, d] of lines) {
      context.moveTo(a, b)
      context.lineTo(c, d)
    }
    context.stroke()
  }

  private strokeBones(pixels: Float32Array) {
    const { context } = this
    context.beginPath()
    this.motion.joint_parents.forEach((parent, joint) => {
      if (parent === null || pixels[2 * joint] !== pixels[2 * joint] || pixels[2 * parent] !== pixels[2 * parent]) return
      context.moveTo(pixels[2 * parent], pixels[2 * parent + 1])
      context.lineTo(pixels[2 * joint], pixels[2 * joint + 1])
    })
    context.stroke()
  }

  private drawDetections(detections: CameraDetections, side: Side, view: number, frame: number, look: OverlayLook, statistics: OverlayStatistics) {
    const assigned = side === 'raw' ? (detections.cleaning?.before ?? detections.person) : detections.person
    for (let d = detections.starts[frame]; d < detections.starts[frame + 1]; d++) {
      statistics.n_detections++
      const index = this.motion.people.findIndex((person) => person.id === assigned[d])
      if (index < 0) statistics.n_rejected++
      if (detections.cleaning?.rows.has(d)) statistics.n_repaired++
      if (!isShown(look, index)) continue
      if (look.detections) this.drawDetection(detections, side, d, index)
      if (side === 'denoised' && look.residuals && index >= 0) this.drawResiduals(detections, d, index, view, frame, statistics)
    }
  }

  /** Raw: in the colour of the assigned person. Denoised: white, rejected points red, with a description of the changes. */
  private drawDetection(detections: CameraDetections, side: Side, d: number, index: number) {
    const { context, motion } = this
    const n = motion.keypoint_names.length
    const source = (k: number) => (side === 'raw' ? k : sourceOf(detections, d, k, n))
    this.pen(index < 0 ? REJECTED : side === 'raw' ? personColor(index) : WHITE, side === 'raw' ? 2 : 1.3, 0.9, index < 0 ? [5, 4] : [])
    context.beginPath()
    for (const [a, b] of this.edges.map(([a, b]) => [source(a), source(b)])) {
      if (a < 0 || b < 0 || Math.min(detections.confidence[d * n + a], detections.confidence[d * n + b]) < MIN_CONFIDENCE) continue
      context.moveTo(detections.pixels[2 * (d * n + a)], detections.pixels[2 * (d * n + a) + 1])
      context.lineTo(detections.pixels[2 * (d * n + b)], detections.pixels[2 * (d * n + b) + 1])
    }
    context.stroke()
    if (side === 'raw') return
    this.crossOut(detections, d, (k) => source(k) < 0)
    this.annotate(detections, d, index < 0 ? 'rejected' : changesOf(detections, d, n), index)
  }

  /** Draws a cross on every rejected point. */
  private crossOut(detections: CameraDetections, d: number, isRejected: (k: number) => boolean) {
    const { context } = this
    const n = this.motion.keypoint_names.length
    const arm = 4.5 * this.scale
    this.pen(REJECTED, 2, 1)
    context.beginPath()
    for (let k = 0; k < n; k++) {
      const [x, y] = [detections.pixels[2 * (d * n + k)], detections.pixels[2 * (d * n + k) + 1]]
      if (!isRejected(k) || x !== x) continue
      context.moveTo(x - arm, y - arm)
      context.lineTo(x + arm, y + arm)
      context.moveTo(x - arm, y + arm)
      context.lineTo(x + arm, y - arm)
    }
    context.stroke()
  }

  /** Writes text above the highest point of a detection. */
  private annotate(detections: CameraDetections, d: number, words: string, index: number) {
    if (!words) return
    const { context } = this
    const n = this.motion.keypoint_names.length
    let [x, y] = [0, Infinity]
    for (let k = 0; k < n; k++) {
      const i = 2 * (d * n + k)
      if (detections.pixels[i + 1] < y) [x, y] = [detections.pixels[i], detections.pixels[i + 1]]
    }
    if (y === Infinity) return
    context.font = `600 ${12 * this.scale}px system-ui, sans-serif`
    context.textAlign = 'center'
    this.pen('#0b0f14', 3, 0.85)
    context.lineJoin = 'round'
    context.strokeText(words, x, y - 8 * this.scale)
    context.globalAlpha = 1
    context.fillStyle = index < 0 ? REJECTED : personColor(index)
    context.fillText(words, x, y - 8 * this.scale)
  }

  private drawResiduals(detections: CameraDetections, d: number, index: number, view: number, frame: number, statistics: OverlayStatistics) {
    const { context, motion, pixel } = this
    const person = motion.people[index]
    const row = rowAt(person, frame)
    const n = motion.keypoint_names.length
    for (let k = 0; row >= 0 && k < n; k++) {
      const source = sourceOf(detections, d, k, n)
      if (source < 0 || detections.confidence[d * n + source] < MIN_CONFIDENCE) continue
      const [u, v] = [detections.pixels[2 * (d * n + source)], detections.pixels[2 * (d * n + source) + 1]]
      const i = 3 * (row * n + k)
      const points = person.keypoints
      if (points[i] !== points[i]) continue
      if (!project(motion.cameras[view], points[i], points[i + 1], points[i + 2], pixel)) continue
      const distance = Math.hypot(pixel[0] - u, pixel[1] - v)
      statistics.distances.push(distance)
      const color = errorColor(distance)
      this.pen(color, 2, 1)
      context.beginPath()
      context.moveTo(u, v)
      context.lineTo(pixel[0], pixel[1])
      context.stroke()
      context.fillStyle = color
      context.beginPath()
      context.arc(u, v, 2.6 * this.scale, 0, 2 * Math.PI)
      context.fill()
    }
  }

  /** Sets the line style; `width` and `dash` in screen pixels. */
  private pen(color: string, width: number, opacity: number, dash: number[] = []) {
    this.context.strokeStyle = color
    this.context.globalAlpha = opacity
    this.context.lineWidth = width * this.scale
    this.context.setLineDash(dash.map((length) => length * this.scale))
  }
}

function isShown(look: OverlayLook, index: number) {
  return look.selected === null || look.selected === index || index < 0
}

/** Finger bones in a camera image, both ends, px; without those that reach behind the camera. */
function projectedFingers(motion: Motion, view: number, frame: number, index: number) {
  const lines: [number, number, number, number][] = []
  const [a, b]: [number, number][] = [[0, 0], [0, 0]]
  const camera = motion.cameras[view]
  forEachFingerBone(motion, motion.people[index], rowAt(motion.people[index], frame), (from, i, to, j) => {
    const isSeen = project(camera, from[i], from[i + 1], from[i + 2], a) && project(camera, to[j], to[j + 1], to[j + 2], b)
    if (isSeen) lines.push([...a, ...b])
  })
  return lines
}

/** The 24 body joints in a camera image, [24, 2] px; NaN behind the camera; null where the person is absent. */
export function projectedJoints(motion: Motion, view: number, frame: number, index: number): Float32Array | null {
  const person = motion.people[index]
  const row = rowAt(person, frame)
  if (row < 0) return null
  const pixels = new Float32Array(2 * N_JOINTS).fill(NaN)
  const pixel: [number, number] = [0, 0]
  for (let joint = 0; joint < N_JOINTS; joint++) {
    const i = 3 * (row * N_JOINTS + joint)
    const { joints } = person
    if (project(motion.cameras[view], joints[i], joints[i + 1], joints[i + 2], pixel)) pixels.set(pixel, 2 * joint)
  }
  return pixels
}
