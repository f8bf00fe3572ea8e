// Corrections of a result: a list of edits of people and cameras at the current frame, solved again as a new job.

import { Problem, correctJob, getJob, getReport } from '../api/client'
import type { Correction, Job, Report } from '../api/types'
import { button, el, fill } from '../dom'
import { count, px } from '../format'
import { openDialog } from '../pages/dialog'
import { problemCard } from '../pages/notice'
import type { SceneView } from './view'

/** Label of a corrected job: the id of the job that it corrects. */
const CORRECTS = 'corrects'

/** Plausible heights of people, m. */
const HEIGHTS = { min: 0.5, max: 2.6 }

/** The editor of one result. */
export class CorrectionEditor {
  readonly element: HTMLDetailsElement
  private readonly actions = el('div', { class: 'correction-actions' })
  private readonly list = el('ol', { class: 'corrections' })
  private readonly footer = el('div', { class: 'actions' })
  private readonly trouble = el('div', { 'aria-live': 'polite' })
  private readonly before: HTMLElement
  private readonly solved: Correction[]
  private edits: Correction[]
  private shown = ''

  constructor(private readonly view: SceneView, private readonly job: Job, report: Promise<Report | null>, signal: AbortSignal) {
    this.solved = (job.options.corrections as Correction[] | undefined) ?? []
    this.edits = [...this.solved]
    this.before = el('div')
    this.element = el('details', { class: 'correction-box', open: this.edits.length > 0 },
      el('summary', {}, 'Corrections'), this.actions, this.list, this.footer, this.trouble, this.before)
    this.element.addEventListener('toggle', () => this.show())
    const earlier = job.labels[CORRECTS]
    if (earlier) compare(earlier, job, report, signal).then((found) => fill(this.before, found), () => {})
    this.drawList()
  }

  /** Frame number of the current frame. */
  private get frame() {
    return this.view.motion.first_frame + this.view.frame
  }

  /** Shows the actions for the selection at the current frame. */
  show() {
    const { person, camera } = this.view.state
    const wanted = `${person} ${camera} ${this.frame}`
    if (!this.element.open || wanted === this.shown) return
    this.shown = wanted
    if (person !== null) fill(this.actions, ...this.personActions(this.view.motion.people[person].id))
    else if (camera !== null) fill(this.actions, ...this.cameraActions(this.view.motion.cameras[camera].id))
    else fill(this.actions, el('p', { class: 'hint' }, 'Select a person or a camera: here, in the scene or on the time line.'), this.rangeButton())
  }

  private personActions(person: number) {
    const { frame } = this
    const others = this.view.motion.people.map(({ id }) => id).filter((id) => id !== person)
    const other = el('select', { 'aria-label': 'Other person' }, ...others.map((id) => el('option', { value: String(id) }, `person ${id}`)))
    return [
      el('p', { class: 'hint' }, `Person ${person} at frame ${frame}`),
      others.length > 0 && el('div', { class: 'correction-pair' }, other,
        this.action('Merge', () => ({ action: 'merge', people: [person, Number(other.value)] })),
        this.action(`Exchange from frame ${frame}`, () => ({ action: 'exchange', people: [person, Number(other.value)], frame }))),
      this.action(`Split at frame ${frame}`, () => ({ action: 'split', person, frame })),
      this.action('Exclude person', () => ({ action: 'exclude_person', person })),
      button('Name…', () => ask('Name of the person', el('input', { type: 'text', maxlength: 64, required: true }), (name) => this.add({ action: 'rename', person, name }))),
      button('Height…', () => ask('Standing height without shoes, m', el('input', { type: 'number', step: 0.01, required: true, ...HEIGHTS }),
        (metres) => this.add({ action: 'set_height', person, metres: Number(metres) }))),
      this.rangeButton({ person }),
    ].filter((child) => child !== false)
  }

  private cameraActions(camera: string) {
    return [
      el('p', { class: 'hint' }, `Camera ${camera}`),
      this.action('Exclude camera', () => ({ action: 'exclude_camera', camera })),
      this.rangeButton({ camera }),
    ]
  }

  private action(label: string, made: () => Correction) {
    return button(label, () => this.add(made()))
  }

  private rangeButton(only: { person?: number; camera?: string } = {}) {
    const first = this.view.motion.first_frame
    const limits = { min: first, max: first + this.view.motion.n_frames - 1, required: true, step: 1 }
    return button('Exclude frames…', () => {
      const inputs = ['First frame', 'Last frame'].map((label) => el('input', { type: 'number', 'aria-label': label, value: String(this.frame), ...limits }))
      form('Exclude frames', el('p', { class: 'hint' }, 'Detections in these frames are left out, both ends included.'), inputs, () => {
        const [from, to] = inputs.map(({ value }) => Number(value))
        this.add({ action: 'exclude_frames', frames: [Math.min(from, to), Math.max(from, to)], ...only })
      })
    })
  }

  private add(edit: Correction) {
    this.edits.push(edit)
    this.drawList()
  }

  private drawList() {
    fill(this.list, ...this.edits.map((edit, index) => el('li', { class: index < this.solved.length ? 'is-solved' : '' }, described(edit))))
    const isChanged = JSON.stringify(this.edits) !== JSON.stringify(this.solved)
    fill(this.footer,
      button('Undo', () => (this.edits.pop(), this.drawList()), { disabled: this.edits.length === 0 }),
      button('Solve again', () => this.solve(), { class: 'primary', disabled: !isChanged }))
  }

  private async solve() {
    try {
      const { id } = await correctJob(this.job.id, this.edits, { ...this.job.labels, [CORRECTS]: this.job.id })
      location.hash = `#/jobs/${id}`
    } catch (error) {
      fill(this.trouble, problemCard('The corrections were not accepted', error))
    }
  }
}

/** A correction in words. */
export function described(edit: Correction): string {
  switch (edit.action) {
    case 'rename': return `Person ${edit.person} is named ${edit.name}`
    case 'merge': return `People ${edit.people.join(', ')} are one`
    case 'split': return `Person ${edit.person} is another one from frame ${edit.frame} on`
    case 'exchange': return `People ${edit.people.join(' and ')} are exchanged from frame ${edit.frame}${edit.last_frame === undefined ? ' on' : ` to ${edit.last_frame}`}`
    case 'exclude_camera': return `Camera ${edit.camera} is left out`
    case 'exclude_person': return `Person ${edit.person} is left out`
    case 'exclude_frames': {
      const only = edit.person !== undefined ? ` of person ${edit.person}` : edit.camera !== undefined ? ` of camera ${edit.camera}` : ''
      return `Frames ${edit.frames.join(' to ')}${only} are left out`
    }
    case 'set_height': return `Person ${edit.person} is ${edit.metres} m tall`
  }
}

/** Asks for one value. */
function ask(title: string, input: HTMLInputElement, use: (value: string) => void) {
  input.setAttribute('aria-label', title)
  form(title, null, [input], () => use(input.value.trim()))
}

/** A dialog with inputs, which are checked before they are used. */
function form(title: string, hint: HTMLElement | null, inputs: HTMLInputElement[], use: () => void) {
  const submit = (event: SubmitEvent) => {
    event.preventDefault()
    use()
    dialog.close()
  }
  const fields = el('form', { onsubmit: submit }, hint, ...inputs,
    el('div', { class: 'actions' }, button('Cancel', () => dialog.close()), el('button', { type: 'submit', class: 'primary' }, 'Add')))
  const dialog = openDialog(title, fields)
}

/** What the corrections have changed: people and verdict of both results. */
async function compare(earlier: string, job: Job, report: Promise<Report | null>, signal: AbortSignal): Promise<HTMLElement> {
  const [before, before_job, after] = await Promise.all([getReport(earlier, signal), getJob(earlier, signal), report])
  if (!after) throw new Problem(404, { code: 'no_report', detail: 'The result has no report.' })
  const ids = [...new Set([...before.people, ...after.people].map(({ id }) => id))].sort((a, b) => a - b)
  const cell = (of: Report, id: number) => {
    const person = of.people.find((one) => one.id === id)
    return person ? `${count(person.n_detections, 'detection')}, frames ${person.first_frame} to ${person.last_frame}, ${px(person.reprojection_px?.median)}` : 'none'
  }
  const rows = ids.map((id) => {
    const [was, is] = [cell(before, id), cell(after, id)]
    return el('tr', { class: was === is ? '' : 'is-changed' }, el('th', { scope: 'row' }, `Person ${id}`), el('td', {}, was), el('td', {}, is))
  })
  const verdicts = [before_job.quality?.verdict, job.quality?.verdict].map((verdict) => el('td', {}, verdict ?? '–'))
  return el('details', { class: 'difference' }, el('summary', {}, 'Before and after'),
    el('p', { class: 'hint' }, el('a', { href: `#/jobs/${earlier}` }, 'Open the result before')),
    el('div', { class: 'scroll', tabindex: 0, role: 'region', 'aria-label': 'Before and after' }, el('table', {},
      el('thead', {}, el('tr', {}, el('td'), el('th', { scope: 'col' }, 'Before'), el('th', { scope: 'col' }, 'After'))),
      el('tbody', {}, el('tr', {}, el('th', { scope: 'row' }, 'Verdict'), ...verdicts), ...rows))))
}
