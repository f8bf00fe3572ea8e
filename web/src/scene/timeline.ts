// Time line: presence of each person, marks of repairs and rejections, and the playhead.

import { el } from '../dom'
import { countAt } from '../data/marks'
import type { Motion, Person } from '../data/motion'
import { personColor } from './palette'

const ROW = 15
const BAR = 9
const LABELS = 62
const TOP = 4
const MARKS = 12

export class Timeline {
  readonly element: HTMLElement
  private readonly canvas = el('canvas', { class: 'bars', 'aria-hidden': 'true' })
  private readonly slider: HTMLInputElement
  private readonly picture = document.createElement('canvas')
  private width = 0
  private readonly height: number

  /** `onseek` receives the requested frame index, `onperson` the index of a person whose label is clicked. */
  constructor(private readonly motion: Motion, onseek: (frame: number) => void, onperson: (person: number) => void) {
    this.height = TOP + motion.people.length * ROW + (motion.repaired ? 2 : 1) * MARKS + 10
    const last = Math.max(motion.n_frames - 1, 0)
    this.slider = el('input', { type: 'range', min: 0, max: last, step: 1, value: '0', 'aria-label': 'Frame' })
    this.slider.addEventListener('input', () => onseek(Number(this.slider.value)))
    const personAt = (event: MouseEvent) => {
      const box = this.canvas.getBoundingClientRect()
      const row = Math.floor((event.clientY - box.top - TOP) / ROW)
      const isLabel = event.clientX - box.left < LABELS
      return isLabel && row >= 0 && row < motion.people.length ? row : null
    }
    this.canvas.addEventListener('click', (event) => {
      const person = personAt(event)
      if (person !== null) onperson(person)
    })
    const seek = (event: PointerEvent) => {
      if (event.buttons !== 1 || personAt(event) !== null) return
      const x = event.clientX - this.canvas.getBoundingClientRect().left
      onseek(Math.round(((x - LABELS) / (this.width - LABELS - 8)) * last))
    }
    this.canvas.addEventListener('pointerdown', (event) => (this.canvas.setPointerCapture(event.pointerId), seek(event)))
    this.canvas.addEventListener('pointermove', seek)
    this.element = el('div', { class: 'timeline' }, this.slider, this.canvas)
  }

  /** Redraws after a change of width or colours. */
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
    context.fillStyle = this.color('--ink')
    context.fillRect(this.x(frame) - 0.75, 0, 1.5, this.height)
  }

  private x(frame: number) {
    return LABELS + (frame / Math.max(this.motion.n_frames - 1, 1)) * (this.width - LABELS - 8)
  }

  private color(name: string) {
    return getComputedStyle(document.documentElement).getPropertyValue(name).trim()
  }

  private drawBars(context: CanvasRenderingContext2D) {
    context.clearRect(0, 0, this.width, this.height)
    context.font = '11px system-ui, sans-serif'
    context.textBaseline = 'middle'
    this.motion.people.forEach((person, index) => {
      const top = TOP + index * ROW
      context.globalAlpha = 1
      context.fillStyle = this.color('--ink-soft')
      context.fillText(`Person ${person.id}`, 2, top + BAR / 2)
      this.drawPresence(context, person, index, top)
      this.drawRepairs(context, person, top)
    })
    const below = TOP + this.motion.people.length * ROW + 3
    if (this.motion.repaired) this.drawCounts(context, 'Repaired', this.motion.repaired, '--fair', below)
    this.drawCounts(context, 'Rejected', this.motion.rejected, '--bad', below + (this.motion.repaired ? MARKS : 0))
  }

  /** Opacity shows the number of cameras that see the person; frames without observations are thin. Equal frames are merged. */
  private drawPresence(context: CanvasRenderingContext2D, person: Person, index: number, top: number) {
    const n_keypoints = this.motion.keypoint_names.length
    const most = Math.max(this.motion.cameras.length, 2)
    const lookOf = (row: number) => {
      if (person.valid[row] === 0) return -1
      let views = 0
      for (let k = 0; k < n_keypoints; k++) views = Math.max(views, person.n_views[row * n_keypoints + k])
      return Math.min(views, most)
    }
    context.fillStyle = personColor(index)
    let start = 0
    for (let row = 1; row <= person.n_frames; row++) {
      const look = lookOf(start)
      if (row < person.n_frames && lookOf(row) === look) continue
      context.globalAlpha = look < 0 ? 0.16 : 0.35 + (0.65 * look) / most
      const [left, right] = [start, row].map((at) => Math.round(2 * this.x(person.first + at)) / 2)
      context.fillRect(left, top + (look < 0 ? BAR / 2 - 1 : 0), Math.max(right - left, 0.5), look < 0 ? 2 : BAR)
      start = row
    }
  }

  private drawRepairs(context: CanvasRenderingContext2D, person: Person, top: number) {
    context.globalAlpha = 1
    for (const [frame] of person.repairs) {
      const x = this.x(frame)
      context.fillStyle = this.color('--panel')
      diamond(context, x, top + BAR / 2, 6)
      context.fillStyle = this.color('--ink')
      diamond(context, x, top + BAR / 2, 4)
    }
  }

  /** Draws a bar per frame whose height shows the number of detections in all cameras. */
  private drawCounts(context: CanvasRenderingContext2D, name: string, counts: Uint8Array, color: string, top: number) {
    context.globalAlpha = 1
    context.fillStyle = this.color('--ink-soft')
    context.fillText(name, 2, top + MARKS / 2 - 1)
    context.fillStyle = this.color(color)
    for (let frame = 0; frame < this.motion.n_frames; frame++) {
      const height = Math.min(3 + 2 * countAt(this.motion, counts, frame), MARKS - 2)
      if (height > 3) context.fillRect(this.x(frame) - 0.75, top + MARKS - 2 - height, 1.5, height)
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
