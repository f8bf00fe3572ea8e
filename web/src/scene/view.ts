// Scene view of a job: combines stage, people, cameras and overlay, and redraws after changes.

import { Vector3 } from 'three'
import type { BodyMesh } from '../data/body_mesh'
import type { CameraDetections } from '../data/detections'
import { nextMark } from '../data/marks'
import { type Motion, N_JOINTS, rowAt } from '../data/motion'
import { rawPoints } from '../data/raw_points'
import { el } from '../dom'
import { Labels } from './labels'
import { Overlay, type OverlayStatistics, type Side } from './overlay'
import { LAYERS, People } from './people'
import { pick } from './pick'
import { Rig } from './rig'
import { type Rectangle, Stage } from './stage'
import { COMPARISONS, type SceneState, comparisonsOf, initialState } from './state'
import type { Surface } from './surface'
import { Trails } from './trails'

/** Height of the bar with switches above a camera image, CSS pixels. */
const BAR_HEIGHT = 54

export class SceneView {
  readonly element: HTMLElement
  readonly stage: Stage
  readonly state: SceneState = initialState()
  readonly frameTimes: number[] = []
  statistics: OverlayStatistics | null = null
  detections: CameraDetections[] | null = null
  readonly people: People
  private readonly rig: Rig
  private readonly trails: Trails
  private readonly overlay: Overlay
  private readonly labels: Labels
  private readonly halves = [el('span'), el('span')]
  private readonly divider = el('div', { class: 'divider', hidden: true }, ...this.halves)
  private readonly observer: ResizeObserver
  private request = 0
  private last = 0
  private isSized = false
  private isClosed = false

  /** `ondraw` is called after each picture, `onchange` after each change of the state. */
  constructor(readonly motion: Motion, surface: Surface, private readonly ondraw: () => void, private readonly onchange: () => void) {
    this.stage = new Stage(motion, surface, () => this.invalidate())
    this.people = new People(motion, this.stage.world, this.stage.lens)
    this.rig = new Rig(motion.cameras, this.stage.world, this.stage.lens)
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

  /** Changes the state and requests a new picture. */
  set(change: Partial<SceneState>) {
    Object.assign(this.state, change)
    this.state.at = Math.min(Math.max(this.state.at, 0), this.lastFrame)
    if (change.isPlaying && this.state.at >= this.lastFrame) this.state.at = 0
    const isPossible = comparisonsOf(this.motion, this.state.through !== null).some(({ name }) => name === this.state.compared)
    if (!isPossible) this.state.compared = 'none'
    this.onchange()
    this.invalidate()
  }

  /** Seeks to the previous (-1) or next (1) mark, of the current camera view or of all cameras. */
  toMark(by: number) {
    this.set({ at: nextMark(this.motion, this.state.through, this.frame, by), isPlaying: false })
  }

  /** Requests a new picture. */
  invalidate() {
    if (this.request === 0 && !this.isClosed) this.request = requestAnimationFrame((now) => this.tick(now))
  }

  /** Adds an element between the 3D picture and the overlay. */
  addPictures(element: HTMLElement) {
    this.stage.canvas.after(element)
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

  /** Adds body meshes to all people. */
  addBodies(mesh: BodyMesh) {
    this.people.addBodies(mesh)
    this.invalidate()
  }

  /** Whether the current state needs the detections. */
  get needsDetections() {
    return this.state.through !== null || this.state.compared === 'cleaning'
  }

  private draw() {
    const { state, stage, frame } = this
    if (!this.isSized) return
    const { through } = state
    const isCompared = state.compared !== 'none'
    const look = {
      body: state.body || state.compared === 'body',
      skeleton: state.skeleton,
      points: state.points || (isCompared && through === null),
      selected: state.person,
      isMuted: through !== null,
    }
    const raw = state.compared === 'cleaning' && through === null && this.detections
    this.people.show(frame, look, raw ? rawPoints(this.motion, raw, frame) : null, stage.colors)
    this.trails.show(frame, state.trails && through === null)
    this.rig.show(state.cameras, state.camera, through, stage.colors)
    this.showHalves(isCompared)
    stage.clear()
    if (through !== null) return this.drawThrough(through)
    this.statistics = null
    this.overlay.clear()
    this.drawFree(isCompared)
  }

  private showHalves(isCompared: boolean) {
    this.divider.hidden = !isCompared
    const { halves } = COMPARISONS.find(({ name }) => name === this.state.compared)!
    this.halves.forEach((half, i) => half.textContent !== halves[i] && (half.textContent = halves[i]))
  }

  private drawFree(isCompared: boolean) {
    const { clientWidth: width, clientHeight: height } = this.element
    const whole: Rectangle = { left: 0, top: 0, width, height }
    const [left, right] = halvesOf(whole)
    const { shared, raw, points, body } = LAYERS
    if (this.state.compared === 'cleaning') {
      this.stage.drawFree(left, [shared, raw])
      this.stage.drawFree(right, [shared, points])
    } else if (this.state.compared === 'body') {
      this.stage.drawFree(left, [shared, points])
      this.stage.drawFree(right, [shared, body])
    } else {
      this.stage.drawFree(whole, [shared, points, body])
    }
    this.labels.show(this.frame, this.stage.free, this.stage.world.matrixWorld, whole, this.state.names && !isCompared)
  }

  /** Rectangle of the camera image on the stage. */
  pictureOf(view: number): Rectangle {
    return this.imagePart(this.underBar(), view)
  }

  private underBar(): Rectangle {
    const { clientWidth: width, clientHeight: height } = this.element
    return { left: 0, top: BAR_HEIGHT, width, height: height - BAR_HEIGHT }
  }

  private drawThrough(view: number) {
    const { state, frame } = this
    const { clientWidth: width, clientHeight: height } = this.element
    const detections = this.detections?.[view] ?? null
    const whole = this.underBar()
    const pictures: [Rectangle, Side][] = state.compared === 'cleaning'
      ? [[halvesOf(whole)[0], 'raw'], [halvesOf(whole)[1], 'denoised']]
      : [[whole, 'denoised']]
    this.overlay.begin(width, height)
    for (const [area, side] of pictures) {
      const part = this.imagePart(area, view)
      const look = { ...state, body: state.reprojection && side === 'denoised', selected: state.person }
      this.stage.drawThrough(part, this.motion.cameras[view], side === 'raw' ? [LAYERS.shared] : [LAYERS.shared, LAYERS.points, LAYERS.body])
      this.statistics = this.overlay.show(part, side, view, frame, detections, look)
    }
    this.labels.show(frame, this.stage.free, this.stage.world.matrixWorld, whole, false)
  }

  /** The largest centred rectangle inside `area` with the aspect ratio of the camera image. */
  private imagePart(area: Rectangle, view: number): Rectangle {
    const { width, height } = this.motion.cameras[view]
    const scale = Math.min(area.width / width, area.height / height)
    const [w, h] = [width * scale, height * scale]
    return { left: area.left + (area.width - w) / 2, top: area.top + (area.height - h) / 2, width: w, height: h }
  }

  private resize() {
    const { clientWidth, clientHeight } = this.element
    if (clientWidth === 0 || clientHeight === 0) return
    this.isSized = true
    this.stage.resize(clientWidth, clientHeight)
    // A resized canvas is empty, so draw immediately.
    this.draw()
    this.ondraw()
  }

  private listenForClicks() {
    let [downX, downY] = [0, 0]
    this.stage.canvas.addEventListener('pointerdown', ({ clientX, clientY }) => ([downX, downY] = [clientX, clientY]))
    this.stage.canvas.addEventListener('pointerup', ({ clientX, clientY }) => {
      const isClick = Math.hypot(clientX - downX, clientY - downY) < 4
      if (isClick && this.state.through === null && this.state.compared === 'none') this.choose(clientX, clientY)
    })
  }

  /** Selects the person or camera at a screen point, or clears the selection. */
  private choose(clientX: number, clientY: number) {
    const box = this.element.getBoundingClientRect()
    const screenOf = (point: Vector3) => {
      point.applyMatrix4(this.stage.world.matrixWorld).project(this.stage.free)
      if (Math.abs(point.z) > 1) return null
      return [((point.x + 1) / 2) * box.width, ((1 - point.y) / 2) * box.height] as [number, number]
    }
    this.set(pick(this.motion, this.frame, this.state.cameras, screenOf, clientX - box.left, clientY - box.top))
  }

  /** Centres the free view on the selected person or camera, or resets it. */
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

function halvesOf({ left, top, width, height }: Rectangle): [Rectangle, Rectangle] {
  const half = Math.floor(width / 2)
  return [{ left, top, width: half - 1, height }, { left: left + half + 1, top, width: width - half - 1, height }]
}
