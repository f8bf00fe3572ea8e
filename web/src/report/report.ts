// The report of a job as pictures; prints on paper.

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
    figures(report, motion),
    el('div', { class: 'charts' },
      barChart('Reprojection by camera: median (bar), mean (tick)', 'px', report.cameras.map((camera) => ({
        name: camera.id,
        value: camera.reprojection_px?.median ?? null,
        mark: camera.reprojection_px?.mean,
        note: camera.solved ? 'nothing matched' : 'not placed',
      }))),
      motion && motion.cameras.some(({ sigma_position_mm }) => sigma_position_mm != null) && barChart('Uncertainty of camera positions, one standard deviation', 'mm',
        motion.cameras.map((camera) => ({ name: camera.id, value: camera.sigma_position_mm ?? null, note: camera.R ? 'not known' : 'not placed' }))),
      motion && residuals && lineChart('Reprojection over time, median per camera', 'px', motion.first_frame,
        motion.cameras.map((camera, i) => ({ name: camera.id, color: CAMERA_COLORS[i % 8], values: residuals[i] }))),
      motion && motion.people.length > 0 && lineChart('Joint acceleration over time, mean of the body', 'm/s²', motion.first_frame,
        accelerationOverTime(motion).map((values, i) => ({ name: `Person ${motion.people[i].id}`, color: personColor(i), values }))),
      barChart('Reprojection by person: median (bar), mean (tick)', 'px', report.people.map((person) => ({
        name: `Person ${person.id}`,
        value: person.reprojection_px?.median ?? null,
        mark: person.reprojection_px?.mean,
      })))),
    cameraTable(report, motion),
    peopleTable(report),
    keypointTable(report),
    consistencyTable(report),
    stageTable(report, job))
}

function verdict({ verdict, reasons }: Quality) {
  const text = { pass: 'Nothing speaks against this result.', warn: 'Look before use.', reject: 'Do not use this result.' }[verdict]
  return el('div', { class: `verdict verdict-box-${verdict}` },
    el('h2', {}, verdictChip(verdict), text),
    reasons.length > 0 && el('ul', {}, ...reasons.map(reasonLine)))
}

/** What was found, and after the last semicolon what to do about it. */
function reasonLine(reason: string) {
  const at = reason.lastIndexOf('; ')
  if (at < 0) return el('li', {}, reason)
  return el('li', {}, reason.slice(0, at), el('span', { class: 'remedy' }, reason.slice(at + 2)))
}

function figures(report: Report, motion: Motion | null) {
  const placed = report.cameras.filter(({ solved }) => solved).length
  const { scale } = report
  const cells: [string, string, string][] = [
    ['Cameras placed', `${placed} of ${report.cameras.length}`, ''],
    ['People', String(report.people.length), motion ? `${motion.n_frames} frames at ${motion.fps} a second` : ''],
    ['Held-out error', px(report.heldout_px, 2), 'cameras from every other block of frames, judged on the rest'],
    ['Scale', scale ? scale.value.toFixed(3) : NOTHING,
      scale ? `${scale.interval95[0].toFixed(3)} to ${scale.interval95[1].toFixed(3)} with 95 % certainty` : 'given by the session'],
    ['Detections rejected', percent(report.rejected_detections, 1), 'given to nobody'],
  ]
  return el('div', {},
    el('dl', { class: 'figures-row' }, ...cells.map(([name, value, note]) =>
      el('div', {}, el('dt', {}, name), el('dd', {}, el('strong', {}, value), el('span', { class: 'hint' }, note))))),
    scale && el('p', { class: 'hint scale' }, `Scale from ${scale.evidence}.`))
}

function cameraTable(report: Report, motion: Motion | null) {
  return table('Cameras', ['Camera', 'Position known to', 'Direction known to', 'Median', 'Mean', 'Median on the body', 'Keypoints rejected', 'Detections', 'Rejected'],
    report.cameras.map((camera) => {
      const posed = motion?.cameras.find(({ id }) => id === camera.id)
      return [camera.id, known(millimetres(posed?.sigma_position_mm)), known(degrees(posed?.sigma_angle_deg)),
        px(camera.reprojection_px?.median, 2), px(camera.reprojection_px?.mean, 2), millimetres(camera.reprojection_mm?.median), percent(camera.rejected_keypoints, 1),
        camera.n_detections, camera.n_rejected_detections]
    }))
}

function known(text: string) {
  return text === NOTHING ? text : `± ${text}`
}

function peopleTable(report: Report) {
  return table('People', ['Person', 'Frames', 'In two cameras', 'Median', 'Mean', 'Keypoints known to', 'Bone lengths vary by', 'Mean acceleration', 'Detections'],
    report.people.map((person) => [`Person ${person.id}`, `${person.first_frame} to ${person.last_frame}`,
      percent(person.share_in_two_views), px(person.reprojection_px?.median, 2), px(person.reprojection_px?.mean, 2),
      known(millimetres(person.sigma_mm?.median)), percent(person.bone_length_spread, 1),
      acceleration(person.jitter_m_per_s2), person.n_detections]))
}

/** Keypoint by keypoint: distance from what was seen, on the body, and how well the place in space is known. */
function keypointTable({ people }: Report) {
  const names = people[0]?.keypoints?.map(({ keypoint }) => keypoint) ?? []
  if (names.length === 0) return null
  return table('Keypoints: median error on the body, known to', ['Keypoint', ...people.map(({ id }) => `Person ${id}`)],
    names.map((name, i) => [words(name), ...people.map(({ keypoints }) => {
      const figures = keypoints?.[i]
      return `${millimetres(figures?.reprojection_mm?.median)}, ${known(millimetres(figures?.sigma_mm?.median))}`
    })]))
}

/** Camera by camera, all people together; the scene shows each of them where it happened. */
function consistencyTable({ consistency, cameras }: Report) {
  if (!consistency) return el('p', { class: 'hint' }, 'Detections were taken as they came: the consistency stage was switched off.')
  const sumOf = (camera: string, count: (pair: ConsistencyPair) => number) =>
    consistency.pairs.filter((pair) => pair.camera === camera).reduce((sum, pair) => sum + count(pair), 0)
  return table('Repaired and rejected', ['Camera', 'Swaps of identity', 'Left and right exchanged', 'Joints rejected', 'Detections taken away'],
    cameras.map(({ id }) => [id, sumOf(id, (pair) => pair.swaps_repaired.length), sumOf(id, (pair) => pair.flips_undone),
      sumOf(id, (pair) => pair.rejected_joints), sumOf(id, (pair) => pair.rejected_detections)]))
}

function stageTable(report: Report, job: Job) {
  const times = Object.entries(job.stage_seconds).map(([stage, time]) => `${words(stage)} ${seconds(time)}`).join(' · ')
  const cost = (value: number | null) => (value === null ? NOTHING : value.toPrecision(5))
  return el('div', {},
    table('Stages', ['Stage', 'Iterations', 'Cost before', 'Cost after', 'Ended because'],
      report.stages.map((stage) => [words(stage.stage), stage.iterations, cost(stage.cost_before), cost(stage.cost_after), words(stage.termination)])),
    times ? el('p', { class: 'hint' }, `Time: ${times}.`) : null,
    el('p', { class: 'hint' }, `Keypoints in the world are ${report.keypoints_from}. ${count(report.stages.length, 'step')} in all.`))
}

function table(title: string, columns: string[], rows: Child[][]) {
  const cell = (child: Child, i: number) => (i === 0 ? el('th', { scope: 'row' }, child) : el('td', { class: 'number' }, child))
  return el('div', { class: 'table-box', tabindex: 0, role: 'region', 'aria-label': title },
    el('table', {}, el('caption', {}, title),
      el('thead', {}, el('tr', {}, ...columns.map((name) => el('th', { scope: 'col' }, name)))),
      el('tbody', {}, ...rows.map((row) => el('tr', {}, ...row.map(cell))))))
}
