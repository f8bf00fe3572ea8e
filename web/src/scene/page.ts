// The scene page of a job: loads the result's buffers, puts the parts together, hears the keyboard.

import { getArtifact, getReport } from '../api/client'
import type { Job } from '../api/types'
import { readDetections } from '../data/detections'
import { readMotion } from '../data/motion'
import { button, el, fill } from '../dom'
import { showHelp } from '../pages/help'
import { onThemeChange } from '../theme'
import { press } from './keys'
import { projectedJoints } from './overlay'
import { CameraLine, Panel } from './panel'
import { SPEEDS, SWITCHES } from './state'
import { Timeline } from './timeline'
import { SceneView } from './view'

/** A page that is shown until `close`. */
export interface OpenScene {
  element: HTMLElement
  close: () => void
}

/** Null where the result holds nothing to draw. */
export async function openScene(job: Job, signal: AbortSignal): Promise<OpenScene | null> {
  const [bytes, report] = await Promise.all([
    getArtifact(job.id, 'stages/motion.bin', signal),
    getReport(job.id, signal).catch(() => null),
  ])
  if (!bytes) return null
  const motion = readMotion(bytes)
  const view = new SceneView(motion, () => draw(), () => change())
  const timeline = new Timeline(motion, (frame) => view.set({ at: frame, isPlaying: false }))
  const panel = new Panel(view, report)
  const line = new CameraLine(view)
  const transport = new Transport(view)
  const switches = new Switches(view)
  let isAsked = false

  const draw = () => {
    timeline.show(view.frame, transport.show())
    line.show()
  }
  const change = () => {
    panel.show()
    switches.show()
    transport.show()
    if (view.state.through !== null && !isAsked) {
      isAsked = true
      loadDetections(job, view, signal)
    }
  }
  const element = el(
    'div',
    { class: 'scene' },
    el('div', { class: 'scene-main' },
      el('div', { class: 'stage-frame' }, view.element, switches.element, line.element),
      el('div', { class: 'bottom' }, transport.element, timeline.element)),
    panel.element,
  )
  const onkey = (event: KeyboardEvent) => {
    const isInFront = element.offsetParent !== null && !document.querySelector('dialog[open]')
    if (isInFront && press(view, event, showHelp)) event.preventDefault()
  }
  document.addEventListener('keydown', onkey)
  const observer = new ResizeObserver(() => (timeline.resize(), draw()))
  observer.observe(timeline.element)
  const forgetTheme = onThemeChange(() => (view.repaint(), timeline.resize(), draw()))
  change()
  inspect(view)
  const close = () => {
    document.removeEventListener('keydown', onkey)
    observer.disconnect()
    forgetTheme()
    view.close()
    inspect(null)
  }
  return { element, close }
}

async function loadDetections(job: Job, view: SceneView, signal: AbortSignal) {
  const bytes = await getArtifact(job.id, 'stages/detections.bin', signal).catch(() => null)
  if (bytes) view.detections = readDetections(bytes)
  view.invalidate()
}

/** What the console and the checks may ask of the scene on show. */
function inspect(view: SceneView | null) {
  const surface = view && {
    frame: () => view.frame,
    seek: (frame: number) => view.set({ at: frame, isPlaying: false }),
    /** The body's joints in a camera's image as the overlay draws them, px. */
    projectedJoints: (camera: number, frame: number, person: number) => {
      const pixels = projectedJoints(view.motion, camera, frame, person)
      return pixels && Array.from(pixels)
    },
    /** Where the three-dimensional picture through a camera shows a point of the world, px, lens distortion apart. */
    pixelThrough: (camera: number, point: [number, number, number]) =>
      view.stage.pixelThrough(view.motion.cameras[camera], point),
    frameTimes: () => [...view.frameTimes],
    memory: () => view.stage.memory,
  }
  Reflect.set(window, 'wandless', surface)
}

class Transport {
  readonly element: HTMLElement
  private readonly play: HTMLButtonElement
  private readonly speed: HTMLSelectElement
  private readonly clock = el('span', { class: 'clock' })

  constructor(private readonly view: SceneView) {
    const step = (by: number) => view.set({ at: view.frame + by, isPlaying: false })
    this.play = button('Play', () => view.set({ isPlaying: !view.state.isPlaying }), { class: 'play' })
    const options = SPEEDS.map((speed) => el('option', { value: String(speed) }, `${speed} ×`))
    this.speed = el('select', { 'aria-label': 'Speed' }, ...options)
    this.speed.addEventListener('change', () => view.set({ speed: Number(this.speed.value) }))
    this.element = el(
      'div',
      { class: 'transport' },
      button('One frame back', () => step(-1), { class: 'icon', 'aria-label': 'One frame back', title: '←' }, '‹'),
      this.play,
      button('One frame on', () => step(1), { class: 'icon', 'aria-label': 'One frame on', title: '→' }, '›'),
      this.speed,
      this.clock,
      el('span', { class: 'legend marks' }, '◆ identity repaired', el('i', { class: 'rejected-mark' }), 'detection rejected'),
      button('Keys', showHelp, { class: 'quiet', title: '?' }),
    )
  }

  /** Writes the time down and returns it. */
  show() {
    const { view } = this
    const { fps, first_frame, n_frames } = view.motion
    this.play.textContent = view.state.isPlaying ? 'Pause' : 'Play'
    this.speed.value = String(view.state.speed)
    const seconds = (view.frame / fps).toFixed(2)
    const text = `frame ${first_frame + view.frame} · ${seconds} s of ${((n_frames - 1) / fps).toFixed(2)} s`
    if (this.clock.textContent !== text) this.clock.textContent = text
    return text
  }
}

class Switches {
  readonly element = el('div', { class: 'switches', role: 'toolbar', 'aria-label': 'What is shown' })
  private isThrough: boolean | null = null

  constructor(private readonly view: SceneView) {}

  show() {
    const isThrough = this.view.state.through !== null
    if (isThrough !== this.isThrough) this.build(isThrough)
    this.isThrough = isThrough
    for (const child of this.element.querySelectorAll('button')) {
      const found = SWITCHES.find(({ name }) => name === child.dataset.switch)
      if (found) child.setAttribute('aria-pressed', String(this.view.state[found.name]))
    }
  }

  private build(isThrough: boolean) {
    const shown = SWITCHES.filter(({ inCamera, name }) => inCamera === isThrough || (isThrough && name === 'body'))
    const buttons = shown.map(({ name, label, key, title }) =>
      button(label, () => this.view.set({ [name]: !this.view.state[name] }), {
        'data-switch': name,
        'aria-pressed': 'false',
        title: `${title} (${key.toUpperCase()})`,
      }),
    )
    fill(this.element, ...buttons)
  }
}
