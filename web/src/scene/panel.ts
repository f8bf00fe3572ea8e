// Panel beside the scene: lists of people and cameras with their statistics, for selection and camera views.

import type { Quality, Report } from '../api/types'
import type { Camera, Motion } from '../data/motion'
import { median } from '../data/residuals'
import { button, el, fill } from '../dom'
import { acceleration, count, degrees, metres, millimetres, percent, px } from '../format'
import { verdictChip } from '../pages/chips'
import { WORST_PX, errorColor, personColor } from './palette'
import { SIGMA_SCALE } from './rig'
import type { SceneView } from './view'

export class Panel {
  readonly element: HTMLElement
  private readonly people: HTMLButtonElement[]
  private readonly cameras: { select: HTMLButtonElement; look: HTMLButtonElement }[]
  private readonly details = el('div', { class: 'details', 'aria-live': 'polite' })
  private readonly note = el('p', { class: 'hint note', role: 'status' })
  private readonly quality = el('div', { class: 'quality' })
  private report: Report | null = null
  private shown = ''

  constructor(private readonly view: SceneView) {
    const { motion } = view
    this.people = motion.people.map((_, index) => this.personRow(motion, index))
    this.cameras = motion.cameras.map((_, index) => this.cameraRow(motion, index))
    this.element = el(
      'aside',
      { class: 'panel', 'aria-label': 'People and cameras' },
      this.quality,
      el('h2', {}, 'People'),
      this.people.length ? el('ul', {}, ...this.people.map((row) => el('li', {}, row))) : noPeople(),
      this.note,
      el('h2', {}, 'Cameras'),
      el('ul', {}, ...this.cameras.map(({ select, look }) => el('li', { class: 'camera-row' }, select, look))),
      this.details,
    )
  }

  private personRow(motion: Motion, index: number) {
    const person = motion.people[index]
    const swatch = el('span', { class: 'swatch', 'aria-hidden': 'true' })
    swatch.style.background = personColor(index)
    return button(
      `Person ${person.id}`,
      () => this.view.set({ person: this.view.state.person === index ? null : index, camera: null }),
      { class: 'row', 'aria-pressed': 'false' },
      swatch,
      el('span', { class: 'row-name' }, `Person ${person.id}`),
      el('span', { class: 'row-figure', title: 'Median reprojection error' }),
    )
  }

  private cameraRow(motion: Motion, index: number) {
    const camera = motion.cameras[index]
    const select = button(
      camera.id,
      () => this.view.set({ camera: this.view.state.camera === index ? null : index, person: null }),
      { class: 'row', 'aria-pressed': 'false' },
      el('span', { class: 'swatch camera-swatch', 'aria-hidden': 'true' }),
      el('span', { class: 'row-name' }, camera.id),
      el('span', { class: 'row-figure' }, camera.R ? px(camera.reprojection_px?.median) : 'not solved'),
    )
    const look = button(
      'Look',
      () => this.view.set(this.view.state.through === index ? { through: null } : { through: index, camera: index }),
      { class: 'look', 'aria-pressed': 'false', 'aria-label': `Look through ${camera.id}`, disabled: !camera.R },
    )
    return { select, look }
  }

  /** Adds the statistics of the report once it is loaded. */
  setReport(report: Report | null) {
    this.report = report
    fill(this.quality, ...qualityNotice(report?.quality))
    this.people.forEach((row, index) => {
      const statistics = report?.people.find(({ id }) => id === this.view.motion.people[index].id)
      row.querySelector('.row-figure')!.textContent = px(statistics?.reprojection_px?.median)
      if (statistics?.name) row.querySelector('.row-name')!.textContent = statistics.name
    })
    this.shown = ''
    this.show()
  }

  /** Shows a note about all people. */
  setNote(text: string) {
    this.note.textContent = text
  }

  /** Highlights the selection and shows its details. */
  show() {
    const { person, camera, through } = this.view.state
    this.people.forEach((row, index) => row.setAttribute('aria-pressed', String(index === person)))
    this.cameras.forEach(({ select, look }, index) => {
      select.setAttribute('aria-pressed', String(index === camera))
      look.setAttribute('aria-pressed', String(index === through))
    })
    const wanted = `${person} ${camera}`
    if (wanted === this.shown) return
    this.shown = wanted
    if (person !== null) fill(this.details, ...this.personDetails(person))
    else if (camera !== null) fill(this.details, ...this.cameraDetails(camera))
    else fill(this.details, el('p', { class: 'hint' }, 'Select a person or a camera, here or in the scene.'))
  }

  private personDetails(index: number) {
    const { motion } = this.view
    const person = motion.people[index]
    const statistics = this.report?.people.find((one) => one.id === person.id)
    const unobserved = person.valid.reduce((n, valid) => n + (valid ? 0 : 1), 0)
    const from = motion.first_frame + person.first
    return [
      el('h3', {}, `Person ${person.id}`),
      table([
        ['Frames', `${from} to ${from + person.n_frames - 1}`],
        ['Median error', px(statistics?.reprojection_px?.median)],
        ['Bone length variation', percent(statistics?.bone_length_spread, 1)],
        ['Mean acceleration', acceleration(statistics?.jitter_m_per_s2)],
        ['Frames without observations', unobserved ? count(unobserved, 'frame') : 'none'],
        ['Identities repaired', person.repairs.length ? count(person.repairs.length, 'time') : 'none'],
      ]),
    ]
  }

  private cameraDetails(index: number) {
    const camera = this.view.motion.cameras[index]
    const statistics = this.report?.cameras.find((one) => one.id === camera.id)
    const position = camera.position?.map((c) => c.toFixed(2)).join(', ')
    return [
      el('h3', {}, camera.id),
      table([
        ['Image', `${camera.width}\u202f×\u202f${camera.height}\u202fpx`],
        ['Median error', px(camera.reprojection_px?.median)],
        ['Mean error', px(camera.reprojection_px?.mean)],
        ['Position', position ? `${position} m` : 'not solved'],
        ['Height', metres(camera.position?.[this.view.motion.up_axis === 'y' ? 1 : 2])],
        ['Position sigma', camera.sigma_position_mm == null ? '–' : `± ${millimetres(camera.sigma_position_mm)}`],
        ['Direction sigma', camera.sigma_angle_deg == null ? '–' : `± ${degrees(camera.sigma_angle_deg)}`],
        ...lensRow(camera),
        ['Rejected', statistics ? `${statistics.n_rejected_detections} of ${statistics.n_detections} detections` : '–'],
      ]),
      el('p', { class: 'hint' }, `The sphere shows the standard deviation of the position, enlarged ${SIGMA_SCALE} times.`),
    ]
  }
}

/** Verdict with its first reason; empty if the result passed. */
function qualityNotice(quality?: Quality) {
  if (!quality || quality.verdict === 'pass') return []
  const [first, ...others] = quality.reasons
  return [el('div', { class: `verdict verdict-box-${quality.verdict}` },
    verdictChip(quality.verdict),
    first ? el('p', {}, first) : null,
    others.length > 0 && el('p', { class: 'hint' }, `${count(others.length, 'more reason')} in the report.`))]
}

function lensRow({ dist, distortion_model }: Camera): [string, string][] {
  if (dist.every((k) => k === 0)) return []
  return [['Lens', distortion_model ?? 'polynomial']]
}

function noPeople() {
  return el('p', { class: 'hint' }, 'No people were reconstructed. The report lists the reasons.')
}

function table(rows: [string, string][]) {
  return el('dl', {}, ...rows.flatMap(([name, value]) => [el('dt', {}, name), el('dd', {}, value)]))
}

/** Line above a camera image: name, statistics of the frame, colour legend of reprojection errors. */
export class CameraLine {
  readonly element = el('div', { class: 'camera-line', hidden: true })
  private readonly name = el('strong')
  private readonly statistics = el('span', { class: 'figures' })

  constructor(private readonly view: SceneView) {
    const ramp = el('canvas', { class: 'ramp', width: 64, height: 8, 'aria-hidden': 'true' })
    const context = ramp.getContext('2d')!
    for (let x = 0; x < 64; x++) {
      context.fillStyle = errorColor((x / 63) * WORST_PX)
      context.fillRect(x, 0, 1, 8)
    }
    const legend = el('span', { class: 'legend', title: 'Reprojection error' }, '0', ramp, `${WORST_PX} px`)
    const leave = button('Close', () => view.set({ through: null }), { class: 'quiet', title: 'Esc' })
    this.element.append(this.name, this.statistics, legend, leave)
  }

  show() {
    const { through } = this.view.state
    this.element.hidden = through === null
    const { statistics } = this.view
    if (through === null) return
    this.name.textContent = this.view.motion.cameras[through].id
    if (!this.view.detections) return void (this.statistics.textContent = 'The result does not contain detections.')
    if (!statistics) return
    const detected = count(statistics.n_detections, 'detection')
    const repaired = statistics.n_repaired ? `, ${statistics.n_repaired} repaired` : ''
    const rejected = statistics.n_rejected ? `, ${statistics.n_rejected} rejected` : ''
    const middle = statistics.distances.length ? ` · median ${px(median([...statistics.distances]))}` : ''
    this.statistics.textContent = detected + repaired + rejected + middle
  }
}
