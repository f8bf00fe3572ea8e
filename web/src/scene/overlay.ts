// Looking through a camera: its detections and the reprojected body over each other, with the distance between them.

import type { CameraDetections } from '../data/detections'
import { type Motion, N_JOINTS, keypointEdges, rowAt } from '../data/motion'
import { project } from '../data/projection'
import { errorColor, personColor } from './palette'
import type { Rectangle } from './stage'

export interface OverlayLook {
  detections: boolean
  body: boolean
  residuals: boolean
  selected: number | null
}

/** What one picture of the overlay found, for the line beside it. */
export interface OverlayFigures {
  n_detections: number
  n_rejected: number
  distances: number[]
}

/** Points below this confidence (of 255) are not joined by lines. */
const MIN_CONFIDENCE = 26

export class Overlay {
  readonly canvas: HTMLCanvasElement = document.createElement('canvas')
  private readonly context = this.canvas.getContext('2d')!
  private readonly edges: [number, number][]
  private readonly pixel: [number, number] = [0, 0]
  private scale = 1

  constructor(private readonly motion: Motion) {
    this.canvas.className = 'overlay'
    this.canvas.setAttribute('aria-hidden', 'true')
    this.edges = keypointEdges(motion.keypoint_names)
  }

  clear() {
    this.canvas.hidden = true
  }

  /** Draws a frame of a camera into its part of the stage. */
  show(part: Rectangle, view: number, frame: number, seen: CameraDetections | null, look: OverlayLook): OverlayFigures {
    this.place(part, view)
    const figures: OverlayFigures = { n_detections: 0, n_rejected: 0, distances: [] }
    this.motion.people.forEach((_, index) => {
      if (look.body && isShown(look, index)) this.drawBody(index, view, frame)
    })
    if (seen) this.drawDetections(seen, view, frame, look, figures)
    return figures
  }

  /** From here on one unit is one pixel of the filmed image, (0, 0) the centre of the first. */
  private place(part: Rectangle, view: number) {
    const { style } = this.canvas
    const ratio = Math.min(devicePixelRatio, 2)
    this.canvas.hidden = false
    Object.assign(style, { left: `${part.left}px`, top: `${part.top}px` })
    Object.assign(style, { width: `${part.width}px`, height: `${part.height}px` })
    const [width, height] = [Math.round(part.width * ratio), Math.round(part.height * ratio)]
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height })
    this.scale = this.motion.cameras[view].width / width
    this.context.setTransform(1 / this.scale, 0, 0, 1 / this.scale, 0.5 / this.scale, 0.5 / this.scale)
    this.context.clearRect(-1, -1, this.motion.cameras[view].width + 1, this.motion.cameras[view].height + 1)
    this.context.lineCap = 'round'
  }

  private drawBody(index: number, view: number, frame: number) {
    const pixels = projectedJoints(this.motion, view, frame, index)
    if (!pixels) return
    this.pen('#0b0f14', 4.6, 0.55)
    this.strokeBones(pixels)
    this.pen(personColor(index), 2.4, 1)
    this.strokeBones(pixels)
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

  private drawDetections(
    seen: CameraDetections,
    view: number,
    frame: number,
    look: OverlayLook,
    figures: OverlayFigures,
  ) {
    for (let d = seen.starts[frame]; d < seen.starts[frame + 1]; d++) {
      figures.n_detections++
      const index = this.motion.people.findIndex((person) => person.id === seen.person[d])
      if (index < 0) figures.n_rejected++
      if (!isShown(look, index)) continue
      if (look.detections) this.drawDetection(seen, d, index)
      if (look.residuals && index >= 0) this.drawResiduals(seen, d, index, view, frame, figures)
    }
  }

  private drawDetection(seen: CameraDetections, d: number, index: number) {
    const { context, motion } = this
    const n = motion.keypoint_names.length
    const at = (k: number) => 2 * (d * n + k)
    this.pen(index < 0 ? '#e5484d' : '#ffffff', 1.3, 0.9, index < 0 ? [5, 4] : [])
    context.beginPath()
    for (const [a, b] of this.edges) {
      if (Math.min(seen.confidence[d * n + a], seen.confidence[d * n + b]) < MIN_CONFIDENCE) continue
      context.moveTo(seen.pixels[at(a)], seen.pixels[at(a) + 1])
      context.lineTo(seen.pixels[at(b)], seen.pixels[at(b) + 1])
    }
    context.stroke()
  }

  private drawResiduals(
    seen: CameraDetections,
    d: number,
    index: number,
    view: number,
    frame: number,
    figures: OverlayFigures,
  ) {
    const { context, motion, pixel } = this
    const person = motion.people[index]
    const row = rowAt(person, frame)
    const n = motion.keypoint_names.length
    for (let k = 0; row >= 0 && k < n; k++) {
      if (seen.confidence[d * n + k] < MIN_CONFIDENCE) continue
      const [u, v] = [seen.pixels[2 * (d * n + k)], seen.pixels[2 * (d * n + k) + 1]]
      const i = 3 * (row * n + k)
      const points = person.keypoints
      if (points[i] !== points[i]) continue
      if (!project(motion.cameras[view], points[i], points[i + 1], points[i + 2], pixel)) continue
      const distance = Math.hypot(pixel[0] - u, pixel[1] - v)
      figures.distances.push(distance)
      const color = errorColor(distance)
      this.pen(color, 2, 1)
      context.beginPath()
      context.moveTo(u, v)
      context.lineTo(pixel[0], pixel[1])
      context.stroke()
      context.fillStyle = color
      context.beginPath()
      context.arc(u, v, 3 * this.scale, 0, 2 * Math.PI)
      context.fill()
    }
  }

  /** Width in pixels of the screen. */
  private pen(color: string, width: number, opacity: number, dash: number[] = []) {
    this.context.strokeStyle = color
    this.context.globalAlpha = opacity
    this.context.lineWidth = width * this.scale * Math.min(devicePixelRatio, 2)
    this.context.setLineDash(dash.map((length) => length * this.scale))
  }
}

function isShown(look: OverlayLook, index: number) {
  return look.selected === null || look.selected === index || index < 0
}

/** The body's 24 joints in a camera's image, [24, 2] px, NaN behind the camera; null where the person is not there. */
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
