// The page of a job: how it goes, then its scene, its report and its files.

import { Problem, cancelJob, deleteJob, getSession, startJob } from '../api/client'
import { follow } from '../api/follow'
import { type Job, isFinal } from '../api/types'
import { button, el, fill } from '../dom'
import { moment, seconds, words } from '../format'
import { reportPage } from '../report/report'
import { type OpenScene, openScene } from '../scene/page'
import { duration, progressBar, stateChip, verdictChip } from './chips'
import { confirmLoss } from './dialog'
import { filesPage } from './files'
import { causeCard, problemCard } from './notice'

export type Tab = 'scene' | 'report' | 'files'
const TABS: [Tab, string][] = [['scene', 'Scene'], ['report', 'Report'], ['files', 'Files']]

/** Lines of the log that are kept. */
const LOG_LINES = 200

export interface JobPage {
  element: HTMLElement
  show: (tab: Tab) => void
}

export function openJob(id: string, tab: Tab, signal: AbortSignal, onproblem: (problem: Problem | null) => void): JobPage {
  const head = el('div', { class: 'job-bar' })
  const tabs = el('nav', { class: 'tabs', 'aria-label': 'Views of the job', hidden: true })
  const trouble = el('div', { 'aria-live': 'polite' })
  const body = el('div', { class: 'job-body' })
  const element = el('div', { class: 'job-page' }, el('div', { class: 'job-top' }, head, tabs), trouble, body)
  let name = ''
  let job: Job | null = null
  let shown: Tab | null = null
  let scene: OpenScene | null = null
  signal.addEventListener('abort', () => scene?.close())

  const act = async (title: string, action: () => Promise<unknown>) => {
    try {
      await action()
    } catch (error) {
      fill(trouble, problemCard(title, error))
    }
  }
  let headShown = ''
  const time = el('span', { class: 'job-time' })
  const drawHead = (now: Job) => {
    time.textContent = `${moment(now.created_at)} · ${duration(now)}`
    // Progress comes many times a second: a button that is made anew under the pointer takes no click.
    const wanted = JSON.stringify([now.state, now.quality, name])
    if (wanted !== headShown) fill(head, ...headOf(now, name || now.session, time, act))
    headShown = wanted
  }
  const waiting = new Waiting()
  const show = async (wanted: Tab) => {
    tab = wanted
    for (const link of tabs.querySelectorAll('a')) {
      if (link.dataset.tab === wanted) link.setAttribute('aria-current', 'page')
      else link.removeAttribute('aria-current')
    }
    if (job?.state !== 'succeeded' || shown === wanted) return
    shown = wanted
    const content = await contentOf(wanted, job, signal).catch((error) => error)
    if (signal.aborted || shown !== wanted) return closeIfScene(content)
    scene?.close()
    scene = isScene(content) ? content : null
    body.classList.toggle('full', isScene(content))
    if (content instanceof Error) fill(body, problemCard('The result cannot be shown', content))
    else fill(body, isScene(content) ? content.element : content)
  }
  const changed = (now: Job) => {
    job = now
    document.title = `${name || 'job'} · ${now.state} · wandless`
    drawHead(now)
    tabs.hidden = now.state !== 'succeeded'
    if (now.state === 'succeeded') show(tab)
    else if (isFinal(now.state)) fill(body, ending(now))
    else {
      waiting.show(now)
      if (!body.contains(waiting.element)) fill(body, waiting.element)
    }
  }
  fill(tabs, ...TABS.map(([key, label]) => el('a', { href: `#/jobs/${id}/${key}`, 'data-tab': key }, label)))
  follow(id, {
    onJob: (now) => {
      if (!job) getSession(now.session, signal).then((session) => ((name = session.name), changed(job ?? now)), () => {})
      changed(now)
    },
    onLog: (line) => waiting.log(line),
    onProblem: (problem) => {
      if (problem?.status === 404) fill(body, problemCard('There is no such job', problem))
      else onproblem(problem)
    },
  }, signal)
  return { element, show }
}

function isScene(content: unknown): content is OpenScene {
  return typeof content === 'object' && content !== null && 'close' in content && 'element' in content
}

function closeIfScene(content: unknown) {
  if (isScene(content)) content.close()
}

async function contentOf(tab: Tab, job: Job, signal: AbortSignal): Promise<OpenScene | HTMLElement> {
  if (tab === 'report') return reportPage(job, signal)
  if (tab === 'files') return filesPage(job, signal)
  const scene = await openScene(job, signal)
  if (scene) return scene
  return causeCard('There is no scene to show', {
    code: 'no_scene',
    detail: 'This result was made by a version that did not write stages/motion.bin.',
    remedy: 'Solve the session again, or take its files from the tab Files.',
  })
}

function headOf(job: Job, name: string, time: HTMLElement, act: (title: string, action: () => Promise<unknown>) => void) {
  const remove = async () => {
    if (!(await confirmLoss(`Delete the job on ${name} and its result?`, 'Delete'))) return
    act('The job was not deleted', async () => {
      await deleteJob(job.id)
      location.hash = '#/'
    })
  }
  const again = () => act('The job was not started', async () => {
    location.hash = `#/jobs/${(await startJob(job.session, job.options)).id}`
  })
  return [
    el('h1', {}, name),
    stateChip(job),
    job.quality && verdictChip(job.quality.verdict),
    time,
    isFinal(job.state)
      ? button('Solve again', again, { class: 'quiet' })
      : button('Cancel', () => act('The job was not canceled', () => cancelJob(job.id)), { disabled: job.state === 'canceling' }),
    isFinal(job.state) && button('Delete', remove, { class: 'quiet' }),
  ]
}

/** What is shown in place of a result. */
function ending(job: Job) {
  if (job.state === 'canceled') {
    return el('section', { class: 'notice' }, el('h2', {}, 'Canceled'), el('p', {}, 'The work has stopped and nothing was kept.'),
      el('p', { class: 'remedy' }, el('strong', {}, 'What to do: '), 'start it again with “Solve again”.'))
  }
  const cause = job.error ?? { code: job.state, detail: 'The job ended without a result.' }
  const remedy = cause.remedy || 'Mend the input, upload it and start a new job; this one keeps its end.'
  return causeCard(job.state === 'dead' ? 'The job died three times' : 'This capture could not be solved', { ...cause, remedy })
}

/** What is shown until there is a result. */
class Waiting {
  private readonly progress = el('div', { role: 'status' })
  private readonly stages = el('ol', { class: 'stages' })
  private readonly lines = el('pre', { class: 'log', tabindex: 0, 'aria-label': 'Lines of the log' })
  private readonly logBox = el('details', { hidden: true }, el('summary', {}, 'Log'), this.lines)
  readonly element = el('section', { class: 'waiting', 'aria-label': 'Progress' }, this.progress, this.stages, this.logBox)

  show(job: Job) {
    fill(this.progress, progressBar(job))
    const done = Object.entries(job.stage_seconds)
    if (done.length !== this.stages.childElementCount) {
      fill(this.stages, ...done.map(([stage, time]) => el('li', {}, `${words(stage)}: ${seconds(time)}`)))
    }
  }

  log(line: string) {
    this.logBox.hidden = false
    this.lines.append(`${line}\n`)
    while (this.lines.childNodes.length > LOG_LINES) this.lines.firstChild?.remove()
  }
}
