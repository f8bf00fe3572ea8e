// Pictures of a camera behind its overlay: a video or an image sequence from the user's disk. Nothing is uploaded.

import { button, el, fill } from '../dom'
import type { Rectangle } from './stage'
import type { SceneView } from './view'

/** Pictures of one camera. */
interface Footage {
  /** The element that shows the picture of a frame, counted from the first picture. */
  element: HTMLVideoElement | HTMLImageElement
  show: (picture: number) => void
  close: () => void
  /** Frame number of the first picture. */
  start: number
}

/** The pictures of all cameras, and the controls to choose those of the current one. */
export class FootageBar {
  readonly element = el('div', { class: 'footage-bar', hidden: true })
  /** Lies between the 3D picture and the overlay. */
  readonly frame = el('div', { class: 'footage', 'aria-hidden': 'true', hidden: true })
  private readonly chosen = new Map<number, Footage>()
  private shown: number | null = null

  constructor(private readonly view: SceneView) {}

  /** Shows the picture of the current frame and camera. */
  show() {
    const { through, compared } = this.view.state
    if (through !== this.shown) this.build(through)
    const footage = through === null || compared !== 'none' ? undefined : this.chosen.get(through)
    this.frame.hidden = !footage
    if (!footage || through === null) return
    place(this.frame, this.view.pictureOf(through))
    footage.show(this.view.motion.first_frame + this.view.frame - footage.start)
  }

  private build(through: number | null) {
    this.shown = through
    this.element.hidden = through === null
    if (through === null) return
    const footage = this.chosen.get(through)
    fill(this.frame, footage?.element)
    const input = el('input', {
      type: 'file', accept: 'video/*,image/*', multiple: true, hidden: true, 'aria-label': 'Video or images of this camera',
      onchange: () => this.choose(through, Array.from(input.files ?? [])),
    })
    const pick = button(footage ? 'Other footage…' : 'Footage…', () => input.click(), { title: 'Show a video or images from your disk behind the overlay; nothing is uploaded' })
    const start = el('input', { type: 'number', step: 1, value: String(footage?.start ?? 0), 'aria-label': 'Frame number of the first picture', title: 'Frame number of the first picture' })
    start.addEventListener('change', () => {
      if (footage && start.value) footage.start = Number(start.value)
      this.view.invalidate()
    })
    fill(this.element, input, pick, ...(footage ? [start, button('Remove', () => this.remove(through), { class: 'quiet' })] : []))
  }

  private choose(camera: number, files: File[]) {
    if (!files.length) return
    this.chosen.get(camera)?.close()
    const { fps, first_frame } = this.view.motion
    const video = files.find(({ type }) => type.startsWith('video/'))
    const redraw = () => this.view.invalidate()
    this.chosen.set(camera, video ? videoOf(video, fps, first_frame, redraw) : imagesOf(files, first_frame))
    this.build(camera)
    redraw()
  }

  private remove(camera: number) {
    this.chosen.get(camera)?.close()
    this.chosen.delete(camera)
    this.build(camera)
    this.view.invalidate()
  }

  close() {
    this.chosen.forEach((footage) => footage.close())
    this.chosen.clear()
  }
}

function place(element: HTMLElement, { left, top, width, height }: Rectangle) {
  Object.assign(element.style, { left: `${left}px`, top: `${top}px`, width: `${width}px`, height: `${height}px` })
}

/** A video whose pictures have the frame rate of the session. */
function videoOf(file: File, fps: number, start: number, onready: () => void): Footage {
  const address = URL.createObjectURL(file)
  const element = el('video', { muted: true, playsinline: true, preload: 'auto' })
  element.muted = true
  element.src = address
  element.addEventListener('loadeddata', onready)
  const show = (picture: number) => {
    element.hidden = picture < 0 || picture / fps > element.duration
    const time = (picture + 0.5) / fps // the middle of the picture, so that rounding cannot show the one before
    if (!element.hidden && !element.seeking && Math.abs(element.currentTime - time) > 0.25 / fps) element.currentTime = time
  }
  element.addEventListener('seeked', onready)
  return { element, show, start, close: () => (element.removeAttribute('src'), URL.revokeObjectURL(address)) }
}

/** Images in the order of their names, numbers as numbers. */
function imagesOf(files: File[], start: number): Footage {
  const sorted = files.filter(({ type }) => type.startsWith('image/')).sort((a, b) => a.name.localeCompare(b.name, 'en', { numeric: true }))
  const element = el('img', { alt: '' })
  let [shown, address] = [-1, '']
  const close = () => URL.revokeObjectURL(address)
  const show = (picture: number) => {
    element.hidden = !(picture in sorted)
    if (element.hidden || picture === shown) return
    close()
    shown = picture
    element.src = address = URL.createObjectURL(sorted[picture])
  }
  return { element, show, start, close }
}
