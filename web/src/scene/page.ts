// The scene page of a job: loads the result's buffers, puts the parts together, hears the keyboard.

import { getArtifact, getReport, request } from '../api/client'
import type { Job } from '../api/types'
import { type BodyMesh, readBodyMesh } from '../data/body_mesh'
import { readDetections } from '../data/detections'
import { readMotion } from '../data/motion'
import { el } from '../dom'
import { showHelp } from '../pages/help'
import { onThemeChange } from '../theme'
import { Switches, Transport } from './controls'
import { press } from './keys'
import { projectedJoints } from './overlay'
import { CameraLine, Panel } from './panel'
import { closeSurface, openSurface } from './surface'
import { Timeline } from './timeline'
import { SceneView } from './view'

/** A page that is shown until `close`. */
export interface OpenScene {
  element: HTMLElement
  close: () => void
}

/** Null where the result holds nothing to draw. */
export async function openScene(job: Job, signal: AbortSignal): Promise<OpenScene | null> {
  const asked = getArtifact(job.id, 'stages/motion.bin', signal)
  const mesh = getDefaultBody(signal).catch(() => null)
  const report = getReport(job.id, signal).catch(() => null)
  const surface = openSurface()
  const motion = await asked.then((bytes) => bytes && readMotion(bytes)).catch((error) => (closeSurface(surface), Promise.reject(error)))
  if (!motion) return closeSurface(surface), null
  const body = await mesh
  const view = new SceneView(motion, surface, () => draw(), () => change())
  const timeline = new Timeline(motion, (frame) => view.set({ at: frame, isPlaying: false }))
  const panel = new Panel(view)
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
    if (view.needsDetections && !isAsked) {
      isAsked = true
      loadDetections(job, view, signal)
    }
  }
  const element = el(
    'div',
    { class: 'scene' },
    el('div', { class: 'scene-main' },
      el('div', { class: 'stage-frame' }, view.element, el('div', { class: 'stage-bar' }, switches.element, line.element)),
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
  report.then((found) => signal.aborted || panel.tell(found))
  dress(view, panel, body)
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

function dress(view: SceneView, panel: Panel, mesh: BodyMesh | null) {
  if (mesh) view.dress(mesh)
  const { people, motion } = view
  if (!people.bodies) panel.remark('People are drawn as skeletons: the mesh of the body, or their poses, could not be had.')
  else if (people.bodies.isLikeness) {
    panel.remark(`Fitted with the body “${motion.body_model?.name ?? 'unknown'}”, which never leaves the service. Drawn is the default body in the same pose and of the same size; the joints are those of the fit.`)
  }
}

async function getDefaultBody(signal: AbortSignal) {
  return readBodyMesh(await (await request('/assets/default-body.bin', { signal })).arrayBuffer())
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
    /** The part of the stage that a camera's image lies on, CSS pixels. */
    pictureOf: (camera: number) => view.pictureOf(camera),
    /** A vertex of a person's body as it is drawn, world metres; null where there is no body. */
    bodyVertex: (person: number, vertex: number) => view.people.bodies?.vertex(person, vertex) ?? null,
    hasDetections: () => view.detections !== null,
    frameTimes: () => [...view.frameTimes],
    memory: () => view.stage.memory,
  }
  Reflect.set(window, 'wandless', surface)
}
