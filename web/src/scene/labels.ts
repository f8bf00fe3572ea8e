// Labels of cameras and people, as HTML elements over the picture.

import { type PerspectiveCamera, type Matrix4, Vector3 } from 'three'
import { el } from '../dom'
import { type Motion, N_JOINTS, rowAt } from '../data/motion'
import { personColor } from './palette'
import type { Rectangle } from './stage'

/** Height of the label of a person above the head joint, m. */
const ABOVE_HEAD = 0.33
const HEAD = 15

export class Labels {
  readonly element = el('div', { class: 'labels', 'aria-hidden': 'true' })
  private readonly cameras: HTMLElement[]
  private readonly people: HTMLElement[]
  private readonly point = new Vector3()

  constructor(private readonly motion: Motion) {
    this.cameras = motion.cameras.map((camera) => el('span', { class: 'label camera-label' }, camera.id))
    this.people = motion.people.map((person, index) => {
      const label = el('span', { class: 'label person-label' }, String(person.id))
      label.style.background = personColor(index)
      return label
    })
    this.element.append(...this.cameras, ...this.people)
  }

  /** Moves every label to its camera or person as seen by `view`; `isShown` false hides all. */
  show(frame: number, view: PerspectiveCamera, threeFromWorld: Matrix4, part: Rectangle, isShown: boolean) {
    this.element.hidden = !isShown
    if (!isShown) return
    const up = this.motion.up_axis === 'y' ? 1 : 2
    this.motion.cameras.forEach(({ position }, i) => {
      if (!position) return void (this.cameras[i].hidden = true)
      this.place(this.cameras[i], this.point.fromArray(position), view, threeFromWorld, part)
    })
    this.motion.people.forEach((person, i) => {
      const row = rowAt(person, frame)
      if (row < 0) return void (this.people[i].hidden = true)
      this.point.fromArray(person.joints, 3 * (row * N_JOINTS + HEAD))
      this.point.setComponent(up, this.point.getComponent(up) + ABOVE_HEAD)
      this.place(this.people[i], this.point, view, threeFromWorld, part)
    })
  }

  private place(label: HTMLElement, point: Vector3, view: PerspectiveCamera, threeFromWorld: Matrix4, part: Rectangle) {
    point.applyMatrix4(threeFromWorld).project(view)
    const isVisible = Math.abs(point.z) < 1 && Math.abs(point.x) < 1.05 && Math.abs(point.y) < 1.05
    label.hidden = !isVisible
    if (!isVisible) return
    const x = part.left + ((point.x + 1) / 2) * part.width
    const y = part.top + ((1 - point.y) / 2) * part.height
    label.style.transform = `translate(${x.toFixed(1)}px, ${y.toFixed(1)}px) translate(-50%, -130%)`
  }
}
