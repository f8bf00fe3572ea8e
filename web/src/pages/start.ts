// Dialogue with the options of a new job and the inspection of its session.

import { inspect, startJob } from '../api/client'
import type { Inspection, Job, Session } from '../api/types'
import { button, el, fill } from '../dom'
import { millimetres, seconds } from '../format'
import { openDialog } from './dialog'
import { problemCard } from './notice'

const EXPORTS = [
  'smpl_npz', 'glb', 'bvh', 'usd', 'trc', 'c3d', 'easymocap', 'opencv_yaml', 'calib_toml', 'anipose_toml', 'colmap',
  'chan', 'blender',
]

/** Opens the dialogue; `onstart` receives the new job. */
export function openStart(session: Session, onstart: (job: Job) => void) {
  const people = el('input', { type: 'number', min: 1, max: 64, id: 'people', placeholder: 'estimated' })
  const extrinsics = select('extrinsics', [
    ['estimate', 'estimated from the people'],
    ...(session.has_extrinsics
      ? ([['fixed', 'given by the session, fixed'], ['refine', 'given by the session, refined']] as [string, string][])
      : []),
  ])
  const height = el('input', { type: 'number', id: 'height', min: 0.5, max: 2.6, step: 0.01, placeholder: 'from body proportions' })
  const upAxis = select('up_axis', [['y', 'y'], ['z', 'z']])
  const toggles = [
    toggle('denoise', 'Repair identity swaps and left-right flips, reject inconsistent joints'),
    toggle('motion_prior', 'Motion prior'),
    toggle('collision', 'Collision resolution between bodies'),
  ]
  const exports = EXPORTS.map((name) => toggle(name, name, name === 'smpl_npz'))
  const trouble = el('div')
  const findings = el('div', { class: 'findings' })
  const form = el('form', { class: 'options' },
    findings,
    field('People', people, 'Number of people, if known.'),
    field('Cameras', extrinsics),
    field('Height of the tallest, m', height, 'Sets the metric scale.'),
    field('Up axis', upAxis),
    el('fieldset', {}, el('legend', {}, 'Stages'), ...toggles.map(({ element }) => element)),
    el('details', {}, el('summary', {}, 'Export formats in addition to JSON'),
      el('div', { class: 'grid' }, ...exports.map(({ element }) => element))),
    trouble,
    el('div', { class: 'actions' }, button('Not now', () => dialog.close()), el('button', { class: 'primary' }, 'Start')),
  )
  form.addEventListener('submit', async (event) => {
    event.preventDefault()
    const options: Record<string, unknown> = { extrinsics: extrinsics.value, up_axis: upAxis.value }
    if (people.value) options.people = Number(people.value)
    if (height.value) options.scale = { from: 'height', metres: Number(height.value), who: 'tallest' }
    for (const { name, input } of toggles) if (!input.checked) options[name] = false
    options.exports = exports.filter(({ input }) => input.checked).map(({ name }) => name)
    try {
      const job = await startJob(session.id, options)
      dialog.close()
      onstart(job)
    } catch (error) {
      fill(trouble, problemCard('The job was rejected', error))
    }
  })
  const dialog = openDialog(`Solve ${session.name}`, form)
  showFindings(session, findings)
}

async function showFindings(session: Session, list: HTMLElement) {
  fill(list, el('p', { class: 'hint', role: 'status' }, 'Inspecting the session…'))
  try {
    const inspection = await inspect(session.id)
    const lines = [...(inspection ? linesOf(inspection) : []), ...session.warnings]
    fill(list, lines.length > 0 && el('h3', {}, 'Inspection'), lines.length > 0 && el('ul', {}, ...lines.map((line) => el('li', {}, line))))
  } catch (error) {
    fill(list, problemCard('The session could not be inspected', error))
  }
}

/** Findings, groups of cameras and expected accuracy and time, one sentence each. */
function linesOf({ findings, groups, cameras, expected }: Inspection) {
  const together = groups.length === 1
    ? `All ${cameras.length} cameras see the same people.`
    : `Groups of cameras without common people: ${groups.map((group) => group.join(', ')).join(' | ')}.`
  const { joint_error_mm, solve_s, cameras_per_person } = expected
  return [
    ...findings.map(({ detail }) => detail),
    groups.length > 0 && together,
    cameras_per_person != null && `Each person is seen by ${cameras_per_person.toFixed(1)} cameras on average.`,
    joint_error_mm != null && `Expected joint error: about ${millimetres(joint_error_mm)}.`,
    solve_s != null && `Expected solve time: about ${seconds(solve_s)}.`,
  ].filter((line): line is string => Boolean(line))
}

function field(label: string, input: HTMLElement, hint?: string) {
  return el('div', { class: 'field' }, el('label', { for: input.id }, label), input, hint ? el('span', { class: 'hint' }, hint) : null)
}

function select(id: string, choices: [string, string][]) {
  return el('select', { id }, ...choices.map(([value, text]) => el('option', { value }, text)))
}

function toggle(name: string, label: string, checked = true) {
  const input = el('input', { type: 'checkbox', checked })
  return { name, input, element: el('label', { class: 'check' }, input, label) }
}
