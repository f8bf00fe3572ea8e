// Scene page of a job: loads the result, assembles the parts and handles the keyboard.

import { getArtifact, getReport, request } from '../api/client'
import { type Job, isStored } from '../api/types'
import { type BodyMesh, readBodyMesh } from '../data/body_mesh'
import { readDetections } from '../data/detections'
import { readMotion } from '../data/motion'
import { el } from '../dom'
import { showHelp } from '../pages/help'
import { onThemeChange } from '../theme'
import { Switches, Transport } from './controls'
import { CorrectionEditor } from './corrections'
import { FootageBar } from './footage'
import { press } from './keys'
import { followLink } from './link'
import { projectedJoints } from './overlay'
import { CameraLine, Panel } from './panel'
import { closeSurface, openSurface } from './surface'
import { Timeline } from './timeline'
import { SceneView } from './view'

/** An open scene; `close` releases its resources. */
export interface OpenScene {
  element: HTMLElement
  close: () => void
}

/** Opens the scene; null if the result contains no motion. */
export async function openScene(job: Job, signal: AbortSignal): Promise<OpenScene | null> {
  const motionFile = getArtifact(job.id, 'stages/motion.bin', signal)
  const mesh = getDefaultBody(signal).catch(() => null)
  const report = getReport(job.id, signal).catch(() => null)
  const surface = openSurface()
  const motion = await motionFile.then((bytes) => bytes && readMotion(bytes)).catch((error) => (closeSurface(surface), Promise.reject(error)))
  if (!motion) return closeSurface(surface), null
  const body = await mesh
  const view = new SceneView(motion, surface, () => draw(), () => change())
  const timeline = new Timeline(motion, (frame) => view.set({ at: frame, isPlaying: false }), (person) => view.set({ person, camera: null }))
  const panel = new Panel(view)
  const editor = isStored(job) ? new CorrectionEditor(view, job, report, signal) : null
  if (editor) panel.element.append(editor.element)
  const line = new CameraLine(view)
  const footage = new FootageBar(view)
  view.addPictures(footage.frame)
  const transport = new Transport(view)
  const switches = new Switches(view)
  let isRequested = false

  const draw = () => {
    timeline.show(view.frame, transport.show())
    line.show()
    footage.show()
    editor?.show()
  }
  const change = () => {
    panel.show()
    editor?.show()
    switches.show()
    transport.show()
    if (view.needsDetections && !isRequested) {
      isRequested = true
      loadDetections(job, view, signal)
    }
  }
  const element = el(
    'div',
    { class: 'scene' },
    el('div', { class: 'scene-main' },
      el('div', { class: 'stage-frame' }, view.element, el('div', { class: 'stage-bar' }, switches.element, line.element, footage.element)),
      el('div', { class: 'bottom' }, transport.element, timeline.element)),
    panel.element,
  )
  const onkey = (event: KeyboardEvent) => {
    const isInFront = element.offsetParent !== null && !document.querySelector('dialog[open]')
    if (isInFront && press(view, event, showHelp)) event.preventDefault()
  }
  const onlink = () => followLink(view)
  document.addEventListener('keydown', onkey)
  window.addEventListener('hashchange', onlink)
  const observer = new ResizeObserver(() => (timeline.resize(), draw()))
  observer.observe(timeline.element)
  const unsubscribeTheme = onThemeChange(() => (view.repaint(), timeline.resize(), draw()))
  change()
  followLink(view)
  report.then((found) => signal.aborted || panel.setReport(found))
  addBodies(view, panel, body)
  exposeForChecks(view)
  const close = () => {
    document.removeEventListener('keydown', onkey)
    window.removeEventListener('hashchange', onlink)
    footage.close()
    observer.disconnect()
    unsubscribeTheme()
    view.close()
    exposeForChecks(null)
  }
  return { element, close }
}

function addBodies(view: SceneView, panel: Panel, mesh: BodyMesh | null) {
  if (mesh) view.addBodies(mesh)
  const { people, motion } = view
  if (!people.bodies) panel.setNote('People are drawn as skeletons because the body mesh or the joint rotations are not available.')
  else if (people.bodies.isSubstitute) {
    panel.setNote(`The people were fitted with the body “${motion.body_model?.name ?? 'unknown'}”, which never leaves the service. The scene shows the default body with the same pose and size; the joints are those of the fit.`)
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

/** Publishes `window.wandless` for the browser checks and the console. */
function exposeForChecks(view: SceneView | null) {
  const surface = view && {
    frame: () => view.frame,
    seek: (frame: number) => view.set({ at: frame, isPlaying: false }),
    /** Body joints in a camera image as drawn by the overlay, px. */
    projectedJoints: (camera: number, frame: number, person: number) => {
      const pixels = projectedJoints(view.motion, camera, frame, person)
      return pixels && Array.from(pixels)
    },
    /** Pixel at which the 3D picture through a camera shows a world point, without lens distortion. */
    pixelThrough: (camera: number, point: [number, number, number]) =>
      view.stage.pixelThrough(view.motion.cameras[camera], point),
    /** Rectangle of the camera image on the stage, CSS pixels. */
    pictureOf: (camera: number) => view.pictureOf(camera),
    /** A vertex of the drawn body of a person, world metres; null without a body. */
    bodyVertex: (person: number, vertex: number) => view.people.bodies?.vertex(person, vertex) ?? null,
    /** Ends of the drawn bones of all skeletons, world metres. */
    skeletonEnds: () => view.people.skeletonEnds,
    hasDetections: () => view.detections !== null,
    frameTimes: () => [...view.frameTimes],
    memory: () => view.stage.memory,
  }
  Reflect.set(window, 'wandless', surface)
}
