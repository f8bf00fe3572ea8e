// The time line: a bar of presence per person, marks where identities were repaired or detections rejected, the playhead.

import { el } from '../dom'
import { type Motion, type Person, rowAt } from '../data/motion'
import { personColor } from './palette'

const ROW = 15
const BAR = 9
const LABELS = 62
const TOP = 4
const MARKS = 13

export class Timeline {
  readonly element: HTMLElement
  private readonly canvas = el('canvas', { class: 'bars', 'aria-hidden': 'true' })
  private readonly slider: HTMLInputElement
  private readonly picture = document.createElement('canvas')
  private width = 0
  private readonly height: number

  /** `onseek` hears the frame index asked for. */
  constructor(private readonly motion: Motion, onseek: (frame: number) => void) {
    this.height = TOP + motion.people.length * ROW + MARKS + 6
    const last = Math.max(motion.n_frames - 1, 0)
    this.slider = el('input', { type: 'range', min: 0, max: last, step: 1, value: '0', 'aria-label': 'Frame' })
    this.slider.addEventListener('input', () => onseek(Number(this.slider.value)))
    const seek = (event: PointerEvent) => {
      if (event.buttons !== 1) return
      const x = event.clientX - this.canvas.getBoundingClientRect().left
      onseek(Math.round(((x - LABELS) / (this.width - LABELS - 8)) * last))
    }
    this.canvas.addEventListener('pointerdown', (event) => (this.canvas.setPointerCapture(event.pointerId), seek(event)))
    this.canvas.addEventListener('pointermove', seek)
    this.element = el('div', { class: 'timeline' }, this.slider, this.canvas)
  }

  /** Takes a new width or new colours. */
  resize() {
    this.width = this.element.clientWidth
    const ratio = Math.min(devicePixelRatio, 2)
    for (const canvas of [this.canvas, this.picture]) {
      Object.assign(canvas, { width: Math.round(this.width * ratio), height: Math.round(this.height * ratio) })
    }
    this.canvas.style.height = `${this.height}px`
    const context = this.picture.getContext('2d')!
    context.setTransform(ratio, 0, 0, ratio, 0, 0)
    this.drawBars(context)
  }

  show(frame: number, description: string) {
    if (Number(this.slider.value) !== frame) this.slider.value = String(frame)
    this.slider.setAttribute('aria-valuetext', description)
    const context = this.canvas.getContext('2d')!
    context.setTransform(1, 0, 0, 1, 0, 0)
    context.clearRect(0, 0, this.canvas.width, this.canvas.height)
    context.drawImage(this.picture, 0, 0)
    const ratio = Math.min(devicePixelRatio, 2)
    context.scale(ratio, ratio)
    context.fillStyle = this.ink('--ink')
    context.fillRect(this.x(frame) - 0.75, 0, 1.5, this.height)
  }

  private x(frame: number) {
    return LABELS + (frame / Math.max(this.motion.n_frames - 1, 1)) * (this.width - LABELS - 8)
  }

  private ink(name: string) {
    return getComputedStyle(document.documentElement).getPropertyValue(name).trim()
  }

  private drawBars(context: CanvasRenderingContext2D) {
    context.clearRect(0, 0, this.width, this.height)
    context.font = '11px system-ui, sans-serif'
    context.textBaseline = 'middle'
    this.motion.people.forEach((person, index) => {
      const top = TOP + index * ROW
      context.globalAlpha = 1
      context.fillStyle = this.ink('--ink-soft')
      context.fillText(`Person ${person.id}`, 2, top + BAR / 2)
      this.drawPresence(context, person, index, top)
      this.drawRepairs(context, person, top)
    })
    this.drawRejected(context, TOP + this.motion.people.length * ROW + 2)
  }

  /** The more cameras see the person, the stronger; carried poses are hollow. */
  private drawPresence(context: CanvasRenderingContext2D, person: Person, index: number, top: number) {
    const n_keypoints = this.motion.keypoint_names.length
    const most = Math.max(this.motion.cameras.length, 2)
    const step = Math.max(1, Math.floor(this.motion.n_frames / Math.max(this.width - LABELS, 1)))
    context.fillStyle = personColor(index)
    for (let frame = 0; frame < this.motion.n_frames; frame += step) {
      const row = rowAt(person, frame)
      if (row < 0) continue
      let views = 0
      for (let k = 0; k < n_keypoints; k++) views = Math.max(views, person.n_views[row * n_keypoints + k])
      const isCarried = person.valid[row] === 0
      context.globalAlpha = isCarried ? 0.16 : 0.35 + (0.65 * Math.min(views, most)) / most
      const width = this.x(frame + step) - this.x(frame) + 0.35
      context.fillRect(this.x(frame), top + (isCarried ? BAR / 2 - 1 : 0), width, isCarried ? 2 : BAR)
    }
  }

  private drawRepairs(context: CanvasRenderingContext2D, person: Person, top: number) {
    context.globalAlpha = 1
    for (const [frame] of person.repairs) {
      const x = this.x(frame)
      context.fillStyle = this.ink('--panel')
      diamond(context, x, top + BAR / 2, 6)
      context.fillStyle = this.ink('--ink')
      diamond(context, x, top + BAR / 2, 4)
    }
  }

  private drawRejected(context: CanvasRenderingContext2D, top: number) {
    context.globalAlpha = 1
    context.fillStyle = this.ink('--ink-soft')
    context.fillText('Rejected', 2, top + 5)
    context.fillStyle = this.ink('--bad')
    for (let frame = 0; frame < this.motion.n_frames; frame++) {
      let n = 0
      for (let c = 0; c < this.motion.cameras.length; c++) n += this.motion.rejected[c * this.motion.n_frames + frame]
      if (n) context.fillRect(this.x(frame) - 0.75, top + 10 - Math.min(3 + 2 * n, 10), 1.5, Math.min(3 + 2 * n, 10))
    }
  }
}

function diamond(context: CanvasRenderingContext2D, x: number, y: number, radius: number) {
  context.beginPath()
  context.moveTo(x, y - radius)
  context.lineTo(x + radius, y)
  context.lineTo(x, y + radius)
  context.lineTo(x - radius, y)
  context.fill()
}
