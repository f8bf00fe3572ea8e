// The scene of a job: stage, people, cameras, overlay and time line, drawn when something changed.

import { Vector3 } from 'three'
import type { CameraDetections } from '../data/detections'
import { type Motion, N_JOINTS, rowAt } from '../data/motion'
import { el } from '../dom'
import { Labels } from './labels'
import { Overlay, type OverlayFigures } from './overlay'
import { LAYERS, People } from './people'
import { Rig } from './rig'
import { ALL_LAYERS, type Rectangle, Stage } from './stage'
import { type SceneState, initialState } from './state'
import { Trails } from './trails'

/** A click nearer to a thing's middle than this chooses it, CSS pixels. */
const REACH = 28

/** Room for the switches over a camera's image, CSS pixels. */
const BAR = 54

export class SceneView {
  readonly element: HTMLElement
  readonly stage: Stage
  readonly state: SceneState = initialState()
  readonly frameTimes: number[] = []
  figures: OverlayFigures | null = null
  detections: CameraDetections[] | null = null
  private readonly people: People
  private readonly rig: Rig
  private readonly trails: Trails
  private readonly overlay: Overlay
  private readonly labels: Labels
  private readonly divider = el('div', { class: 'divider', hidden: true, 'aria-hidden': 'true' },
    el('span', {}, 'Points, before the body'), el('span', {}, 'Body'))
  private readonly observer: ResizeObserver
  private request = 0
  private last = 0
  private isClosed = false

  /** `ondraw` is called after each picture, `onchange` after each change of the state. */
  constructor(readonly motion: Motion, private readonly ondraw: () => void, private readonly onchange: () => void) {
    this.stage = new Stage(motion, () => this.invalidate())
    this.people = new People(motion, this.stage.world)
    this.rig = new Rig(motion.cameras, this.stage.world)
    this.trails = new Trails(motion, this.stage.world)
    this.overlay = new Overlay(motion)
    this.labels = new Labels(motion)
    this.element = el('div', { class: 'stage' }, this.stage.canvas, this.overlay.canvas, this.labels.element, this.divider)
    this.observer = new ResizeObserver(() => this.resize())
    this.observer.observe(this.element)
    this.listenForClicks()
  }

  get frame() {
    return Math.round(this.state.at)
  }

  get lastFrame() {
    return Math.max(this.motion.n_frames - 1, 0)
  }

  /** Changes the state and draws. */
  set(change: Partial<SceneState>) {
    Object.assign(this.state, change)
    this.state.at = Math.min(Math.max(this.state.at, 0), this.lastFrame)
    if (change.isPlaying && this.state.at >= this.lastFrame) this.state.at = 0
    this.onchange()
    this.invalidate()
  }

  /** A new picture at the next chance. */
  invalidate() {
    if (this.request === 0 && !this.isClosed) this.request = requestAnimationFrame((now) => this.tick(now))
  }

  repaint() {
    this.stage.repaint()
    this.invalidate()
  }

  private tick(now: number) {
    this.request = 0
    if (this.state.isPlaying) {
      const passed = this.last ? Math.min((now - this.last) / 1000, 0.25) : 0
      if (this.last) this.noteFrameTime(now - this.last)
      this.last = now
      const at = this.state.at + passed * this.motion.fps * this.state.speed
      this.state.at = at > this.lastFrame ? 0 : at
      this.invalidate()
    } else {
      this.last = 0
    }
    this.draw()
    this.ondraw()
  }

  private noteFrameTime(ms: number) {
    this.frameTimes.push(ms)
    if (this.frameTimes.length > 600) this.frameTimes.shift()
  }

  private draw() {
    const { state, stage, frame } = this
    const isThrough = state.through !== null
    const isCompared = state.isCompared && !isThrough
    const look = { ...state, body: state.body || isCompared, points: state.points || isCompared }
    this.people.show(frame, { ...look, selected: state.person, isMuted: isThrough }, stage.ground)
    this.trails.show(frame, state.trails && !isThrough)
    this.rig.show(state.cameras, state.camera, state.through, stage.ground)
    this.divider.hidden = !isCompared
    stage.clear()
    if (state.through !== null) {
      this.drawThrough(state.through)
    } else {
      this.figures = null
      this.overlay.clear()
      this.drawFree(isCompared)
    }
  }

  private drawFree(isCompared: boolean) {
    const { clientWidth: width, clientHeight: height } = this.element
    const whole: Rectangle = { left: 0, top: 0, width, height }
    if (isCompared) {
      const half = Math.floor(width / 2)
      this.stage.drawFree({ ...whole, width: half }, [LAYERS.shared, LAYERS.points])
      this.stage.drawFree({ ...whole, left: half, width: width - half }, [LAYERS.shared, LAYERS.body])
    } else {
      this.stage.drawFree(whole, ALL_LAYERS)
    }
    this.labels.show(this.frame, this.stage.free, this.stage.world.matrixWorld, whole, this.state.names && !isCompared)
  }

  private drawThrough(view: number) {
    const { state, frame } = this
    const camera = this.motion.cameras[view]
    const part = this.imagePart(camera.width, camera.height)
    this.stage.drawThrough(part, camera)
    const look = { ...state, body: state.reprojection, selected: state.person }
    this.figures = this.overlay.show(part, view, frame, this.detections?.[view] ?? null, look)
    this.labels.show(frame, this.stage.free, this.stage.world.matrixWorld, part, false)
  }

  /** The largest rectangle of an image's shape in the middle of the stage. */
  private imagePart(width: number, height: number): Rectangle {
    const { clientWidth, clientHeight } = this.element
    const room = clientHeight - BAR
    const scale = Math.min(clientWidth / width, room / height)
    const [w, h] = [width * scale, height * scale]
    return { left: (clientWidth - w) / 2, top: BAR + (room - h) / 2, width: w, height: h }
  }

  private resize() {
    const { clientWidth, clientHeight } = this.element
    if (clientWidth === 0 || clientHeight === 0) return
    this.stage.resize(clientWidth, clientHeight)
    // The canvas is empty after a new size: draw at once, not at the next chance.
    this.draw()
    this.ondraw()
  }

  private listenForClicks() {
    let [downX, downY] = [0, 0]
    this.stage.canvas.addEventListener('pointerdown', ({ clientX, clientY }) => ([downX, downY] = [clientX, clientY]))
    this.stage.canvas.addEventListener('pointerup', ({ clientX, clientY }) => {
      const isClick = Math.hypot(clientX - downX, clientY - downY) < 4
      if (isClick && this.state.through === null && !this.state.isCompared) this.choose(clientX, clientY)
    })
  }

  /** Selects what lies under a point of the screen; nothing deselects. */
  private choose(clientX: number, clientY: number) {
    const box = this.element.getBoundingClientRect()
    const point = new Vector3()
    const distanceTo = () => {
      point.applyMatrix4(this.stage.world.matrixWorld).project(this.stage.free)
      if (Math.abs(point.z) > 1) return Infinity
      const [x, y] = [((point.x + 1) / 2) * box.width, ((1 - point.y) / 2) * box.height]
      return Math.hypot(x - (clientX - box.left), y - (clientY - box.top))
    }
    let [best, person, camera] = [REACH, null as number | null, null as number | null]
    const offer = (chosenPerson: number | null, chosenCamera: number | null) => {
      const distance = distanceTo()
      if (distance < best) [best, person, camera] = [distance, chosenPerson, chosenCamera]
    }
    this.motion.people.forEach((one, index) => {
      const row = rowAt(one, this.frame)
      for (let joint = 0; row >= 0 && joint < N_JOINTS; joint++) {
        point.fromArray(one.joints, 3 * (row * N_JOINTS + joint))
        offer(index, null)
      }
    })
    this.motion.cameras.forEach(({ position }, index) => {
      if (!position || !this.state.cameras) return
      point.fromArray(position)
      offer(null, index)
    })
    this.set({ person, camera })
  }

  /** Turns the free view to the selected person or camera. */
  frameSelected() {
    const { person, camera } = this.state
    const point = new Vector3()
    const row = person === null ? -1 : rowAt(this.motion.people[person], this.frame)
    const position = camera === null ? null : this.motion.cameras[camera].position
    if (person !== null && row >= 0) point.fromArray(this.motion.people[person].joints, 3 * row * N_JOINTS)
    else if (position) point.fromArray(position)
    else return this.stage.resetView()
    this.stage.lookAt(point.applyMatrix4(this.stage.world.matrixWorld))
  }

  close() {
    this.isClosed = true
    cancelAnimationFrame(this.request)
    this.observer.disconnect()
    for (const part of [this.people, this.rig, this.trails, this.stage]) part.dispose()
  }
}
