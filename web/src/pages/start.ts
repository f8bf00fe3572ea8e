// Dialogue with the options of a new job and the inspection of its session.

import { inspect, startJob } from '../api/client'
import type { Inspection, Job, Session } from '../api/types'
import { button, el, fill } from '../dom'
import { millimetres, seconds } from '../format'
import { openDialog } from './dialog'
import { problemCard } from './notice'
import { optionInputs } from './options'

/** Opens the dialogue; `onstart` receives the new job. */
export function openStart(session: Session, onstart: (job: Job) => void) {
  const options = optionInputs(session)
  const trouble = el('div')
  const findings = el('div', { class: 'findings' })
  const form = el('form', { class: 'options' },
    findings,
    options.element,
    trouble,
    el('div', { class: 'actions' }, button('Not now', () => dialog.close()), el('button', { class: 'primary' }, 'Start')),
  )
  form.addEventListener('submit', async (event) => {
    event.preventDefault()
    try {
      const job = await startJob(session.id, options.values())
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
