// The options of a new job, with the inspection's findings where the service has them.

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

/** Opens the dialogue; `onstart` hears of the job. */
export function openStart(session: Session, onstart: (job: Job) => void) {
  const people = el('input', { type: 'number', min: 1, max: 64, id: 'people', placeholder: 'found out' })
  const extrinsics = select('extrinsics', [
    ['estimate', 'found from the people'],
    ...(session.has_extrinsics
      ? ([['fixed', "the session's, untouched"], ['refine', "the session's, refined"]] as [string, string][])
      : []),
  ])
  const height = el('input', { type: 'number', id: 'height', min: 0.5, max: 2.6, step: 0.01, placeholder: 'from body proportions' })
  const upAxis = select('up_axis', [['y', 'y'], ['z', 'z']])
  const toggles = [
    toggle('denoise', 'Repair identities and flips, reject bad joints'),
    toggle('motion_prior', 'Motion prior'),
    toggle('collision', 'Bodies do not pass through each other'),
  ]
  const exports = EXPORTS.map((name) => toggle(name, name, name === 'smpl_npz'))
  const trouble = el('div')
  const findings = el('div', { class: 'findings' })
  const form = el('form', { class: 'options' },
    findings,
    field('People', people, 'How many there are, if it is known.'),
    field('Cameras', extrinsics),
    field('Height of the tallest, m', height, 'Gives the scene its size.'),
    field('Up', upAxis),
    el('fieldset', {}, el('legend', {}, 'Stages'), ...toggles.map(({ element }) => element)),
    el('details', {}, el('summary', {}, 'Files to write beside the JSON'),
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
      fill(trouble, problemCard('The job was not accepted', error))
    }
  })
  const dialog = openDialog(`Solve ${session.name}`, form)
  showFindings(session, findings)
}

async function showFindings(session: Session, place: HTMLElement) {
  fill(place, el('p', { class: 'hint', role: 'status' }, 'Looking at the session…'))
  try {
    const inspection = await inspect(session.id)
    const lines = [...(inspection ? linesOf(inspection) : []), ...session.warnings]
    fill(place, lines.length > 0 && el('h3', {}, 'Inspection'), lines.length > 0 && el('ul', {}, ...lines.map((line) => el('li', {}, line))))
  } catch (error) {
    fill(place, problemCard('The session could not be inspected', error))
  }
}

/** The findings, then what may be expected. */
function linesOf({ findings, groups, cameras, expected }: Inspection) {
  const together = groups.length === 1
    ? `All ${cameras.length} cameras see the same people.`
    : `The cameras fall into groups that share nobody: ${groups.map((group) => group.join(', ')).join(' | ')}.`
  const { joint_error_mm, solve_s, cameras_per_person } = expected
  return [
    ...findings.map(({ detail }) => detail),
    groups.length > 0 && together,
    cameras_per_person != null && `Each person is seen by ${cameras_per_person.toFixed(1)} cameras on average.`,
    joint_error_mm != null && `Joints are expected within about ${millimetres(joint_error_mm)}.`,
    solve_s != null && `It will take about ${seconds(solve_s)}.`,
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
