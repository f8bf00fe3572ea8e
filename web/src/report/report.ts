// Report of a job: verdict, statistics, charts and tables; printable.

import { getArtifact, getReport } from '../api/client'
import type { ConsistencyPair, Job, Quality, Report } from '../api/types'
import { readDetections } from '../data/detections'
import { type Motion, readMotion } from '../data/motion'
import { accelerationOverTime, residualsOverTime } from '../data/residuals'
import { button, type Child, el } from '../dom'
import { NOTHING, acceleration, count, degrees, millimetres, percent, px, seconds, words } from '../format'
import { verdictChip } from '../pages/chips'
import { personColor } from '../scene/palette'
import { barChart, lineChart } from './charts'
import { jointCurves } from './joints'

const CAMERA_COLORS = ['#3b82d6', '#c9791a', '#2f9a5d', '#b8487b', '#7a5fd0', '#1f9488', '#9c8715', '#c9503f']

export async function reportPage(job: Job, signal: AbortSignal): Promise<HTMLElement> {
  const [report, motionBytes, detectionBytes] = await Promise.all([
    getReport(job.id, signal),
    getArtifact(job.id, 'stages/motion.bin', signal),
    getArtifact(job.id, 'stages/detections.bin', signal),
  ])
  const motion = motionBytes && readMotion(motionBytes)
  const residuals = motion && detectionBytes ? residualsOverTime(motion, readDetections(detectionBytes)) : null
  return el('section', { class: 'report', 'aria-label': 'Report' },
    el('div', { class: 'report-head' }, verdict(report.quality), button('Print', () => window.print(), { class: 'quiet' })),
    statistics(report, motion),
    el('div', { class: 'charts' },
      barChart('Reprojection by camera: median (bar), mean (tick)', 'px', report.cameras.map((camera) => ({
        name: camera.id,
        value: camera.reprojection_px?.median ?? null,
        mark: camera.reprojection_px?.mean,
        note: camera.solved ? 'no observations' : 'not solved',
      }))),
      motion && motion.cameras.some(({ sigma_position_mm }) => sigma_position_mm != null) && barChart('Standard deviation of camera positions', 'mm',
        motion.cameras.map((camera) => ({ name: camera.id, value: camera.sigma_position_mm ?? null, note: camera.R ? 'unknown' : 'not solved' }))),
      motion && residuals && lineChart('Reprojection over time, median per camera', 'px', motion.first_frame,
        motion.cameras.map((camera, i) => ({ name: camera.id, color: CAMERA_COLORS[i % 8], values: residuals[i] }))),
      motion && motion.people.length > 0 && lineChart('Joint acceleration over time, mean of the body', 'm/s²', motion.first_frame,
        accelerationOverTime(motion).map((values, i) => ({ name: `Person ${motion.people[i].id}`, color: personColor(i), values }))),
      barChart('Reprojection by person: median (bar), mean (tick)', 'px', report.people.map((person) => ({
        name: `Person ${person.id}`,
        value: person.reprojection_px?.median ?? null,
        mark: person.reprojection_px?.mean,
      })))),
    motion && motion.people.length > 0 && jointCurves(motion),
    cameraTable(report, motion),
    peopleTable(report),
    keypointTable(report),
    consistencyTable(report),
    stageTable(report, job))
}

function verdict({ verdict, reasons }: Quality) {
  const text = { pass: 'No problems were found.', warn: 'Check before use.', reject: 'Do not use this result.' }[verdict]
  return el('div', { class: `verdict verdict-box-${verdict}` },
    el('h2', {}, verdictChip(verdict), text),
    reasons.length > 0 && el('ul', {}, ...reasons.map(reasonLine)))
}

/** A reason and, after its last semicolon, the remedy. */
function reasonLine(reason: string) {
  const at = reason.lastIndexOf('; ')
  if (at < 0) return el('li', {}, reason)
  return el('li', {}, reason.slice(0, at), el('span', { class: 'remedy' }, reason.slice(at + 2)))
}

function statistics(report: Report, motion: Motion | null) {
  const n_solved = report.cameras.filter(({ solved }) => solved).length
  const { scale } = report
  const cells: [string, string, string][] = [
    ['Cameras solved', `${n_solved} of ${report.cameras.length}`, ''],
    ['People', String(report.people.length), motion ? `${motion.n_frames} frames at ${motion.fps} fps` : ''],
    ['Held-out error', px(report.heldout_px, 2), 'cross-validation: cameras from every other block of frames, error on the rest'],
    ['Scale', scale ? scale.value.toFixed(3) : NOTHING,
      scale ? `${scale.interval95[0].toFixed(3)} to ${scale.interval95[1].toFixed(3)} (95 % interval)` : 'given by the session'],
    ['Detections rejected', percent(report.rejected_detections, 1), 'not assigned to a person'],
  ]
  return el('div', {},
    el('dl', { class: 'figures-row' }, ...cells.map(([name, value, note]) =>
      el('div', {}, el('dt', {}, name), el('dd', {}, el('strong', {}, value), el('span', { class: 'hint' }, note))))),
    scale && el('p', { class: 'hint scale' }, `Source of the scale: ${scale.evidence}.`))
}

function cameraTable(report: Report, motion: Motion | null) {
  return table('Cameras', ['Camera', 'Position sigma', 'Direction sigma', 'Median error', 'Mean error', 'Median error on the body', 'Keypoints rejected', 'Detections', 'Rejected'],
    report.cameras.map((camera) => {
      const solved = motion?.cameras.find(({ id }) => id === camera.id)
      return [camera.id, withSign(millimetres(solved?.sigma_position_mm)), withSign(degrees(solved?.sigma_angle_deg)),
        px(camera.reprojection_px?.median, 2), px(camera.reprojection_px?.mean, 2), millimetres(camera.reprojection_mm?.median), percent(camera.rejected_keypoints, 1),
        camera.n_detections, camera.n_rejected_detections]
    }))
}

function withSign(text: string) {
  return text === NOTHING ? text : `± ${text}`
}

function peopleTable(report: Report) {
  return table('People', ['Person', 'Frames', 'Seen by 2+ cameras', 'Median error', 'Mean error', 'Keypoint sigma', 'Joint sigma', 'Uncertain frames', 'Bone length variation', 'Mean acceleration', 'Detections'],
    report.people.map((person) => [`Person ${person.id}`, `${person.first_frame} to ${person.last_frame}`,
      percent(person.share_in_two_views), px(person.reprojection_px?.median, 2), px(person.reprojection_px?.mean, 2),
      withSign(millimetres(person.sigma_mm?.median)), withSign(millimetres(person.joint_sigma_mm?.median)), uncertainFrames(person), percent(person.bone_length_spread, 1),
      acceleration(person.jitter_m_per_s2), person.n_detections]))
}

function uncertainFrames({ uncertain_frames }: Report['people'][number]) {
  return uncertain_frames?.map(({ first_frame, last_frame }) => `${first_frame} to ${last_frame}`).join(', ') ?? NOTHING
}

/** Per keypoint: median reprojection error at the distance of the body, and standard deviation of the 3D position. */
function keypointTable({ people }: Report) {
  const names = people[0]?.keypoints?.map(({ keypoint }) => keypoint) ?? []
  if (names.length === 0) return null
  return table('Keypoints: median error on the body, sigma', ['Keypoint', ...people.map(({ id }) => `Person ${id}`)],
    names.map((name, i) => [words(name), ...people.map(({ keypoints }) => {
      const statistics = keypoints?.[i]
      return `${millimetres(statistics?.reprojection_mm?.median)}, ${withSign(millimetres(statistics?.sigma_mm?.median))}`
    })]))
}

/** Changes of the consistency stage per camera, summed over people. */
function consistencyTable({ consistency, cameras }: Report) {
  if (!consistency) return el('p', { class: 'hint' }, 'The consistency stage was switched off; detections were used unchanged.')
  const sumOf = (camera: string, count: (pair: ConsistencyPair) => number) =>
    consistency.pairs.filter((pair) => pair.camera === camera).reduce((sum, pair) => sum + count(pair), 0)
  return table('Repaired and rejected', ['Camera', 'Identity swaps', 'Left-right flips', 'Joints rejected', 'Detections rejected'],
    cameras.map(({ id }) => [id, sumOf(id, (pair) => pair.swaps_repaired.length), sumOf(id, (pair) => pair.flips_undone),
      sumOf(id, (pair) => pair.rejected_joints), sumOf(id, (pair) => pair.rejected_detections)]))
}

function stageTable(report: Report, job: Job) {
  const times = Object.entries(job.stage_seconds).map(([stage, time]) => `${words(stage)} ${seconds(time)}`).join(' · ')
  const cost = (value: number | null) => (value === null ? NOTHING : value.toPrecision(5))
  return el('div', {},
    table('Stages', ['Stage', 'Iterations', 'Cost before', 'Cost after', 'Termination'],
      report.stages.map((stage) => [words(stage.stage), stage.iterations, cost(stage.cost_before), cost(stage.cost_after), words(stage.termination)])),
    times ? el('p', { class: 'hint' }, `Time per stage: ${times}.`) : null,
    el('p', { class: 'hint' }, `Source of the 3D keypoints: ${report.keypoints_from}. ${count(report.stages.length, 'step')} in total.`))
}

function table(title: string, columns: string[], rows: Child[][]) {
  const cell = (child: Child, i: number) => (i === 0 ? el('th', { scope: 'row' }, child) : el('td', { class: 'number' }, child))
  return el('div', { class: 'table-box', tabindex: 0, role: 'region', 'aria-label': title },
    el('table', {}, el('caption', {}, title),
      el('thead', {}, el('tr', {}, ...columns.map((name) => el('th', { scope: 'col' }, name)))),
      el('tbody', {}, ...rows.map((row) => el('tr', {}, ...row.map(cell))))))
}
