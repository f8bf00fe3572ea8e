// Page of a job: progress, then scene, report and files of its result.

import { Problem, cancelJob, deleteJob, getScene, getSession, startJob } from '../api/client'
import { follow } from '../api/follow'
import { type Job, isFinal } from '../api/types'
import type { ProvisionalScene } from '../data/provisional'
import { button, el, fill } from '../dom'
import { localTime, seconds, words } from '../format'
import { reportPage } from '../report/report'
import { type OpenScene, openScene } from '../scene/page'
import { ProvisionalView } from '../scene/provisional'
import { duration, progressBar, stateChip, verdictChip } from './chips'
import { confirmDeletion } from './dialog'
import { filesPage } from './files'
import { causeCard, problemCard } from './notice'

export type Tab = 'scene' | 'report' | 'files'
const TABS: [Tab, string][] = [['scene', 'Scene'], ['report', 'Report'], ['files', 'Files']]

/** Maximum number of log lines on the page. */
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
  signal.addEventListener('abort', () => (scene?.close(), progress.close()))

  const act = async (title: string, action: () => Promise<unknown>) => {
    try {
      await action()
    } catch (error) {
      fill(trouble, problemCard(title, error))
    }
  }
  let headKey = ''
  const time = el('span', { class: 'job-time' })
  const drawHead = (now: Job) => {
    time.textContent = `${localTime(now.created_at)} · ${duration(now)}`
    // Progress arrives many times per second; a button that is recreated under the pointer would not receive clicks.
    const wanted = JSON.stringify([now.state, now.quality, name])
    if (wanted !== headKey) fill(head, ...headOf(now, name || now.session, time, act))
    headKey = wanted
  }
  const progress = new ProgressView()
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
    if (isFinal(now.state)) progress.close()
    if (now.state === 'succeeded') show(tab)
    else if (isFinal(now.state)) fill(body, endNotice(now))
    else {
      progress.show(now)
      if (!body.contains(progress.element)) fill(body, progress.element)
    }
  }
  fill(tabs, ...TABS.map(([key, label]) => el('a', { href: `#/jobs/${id}/${key}`, 'data-tab': key }, label)))
  follow(id, {
    onJob: (now) => {
      if (!job) getSession(now.session, signal).then((session) => ((name = session.name), changed(job ?? now)), () => {})
      changed(now)
    },
    onLog: (line) => progress.log(line),
    // A scene can be gone when it is asked for: the job has ended.
    onScene: () => getScene(id, signal).then((found) => signal.aborted || (job && isFinal(job.state)) || progress.scene(found), () => {}),
    onProblem: (problem) => {
      if (problem?.status === 404) fill(body, problemCard('This job does not exist', problem))
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
  return causeCard('No scene available', {
    code: 'no_scene',
    detail: 'The result of this solver version does not contain stages/motion.bin.',
    remedy: 'Solve the session again, or download the result on the tab Files.',
  })
}

function headOf(job: Job, name: string, time: HTMLElement, act: (title: string, action: () => Promise<unknown>) => void) {
  const remove = async () => {
    if (!(await confirmDeletion(`Delete the job on ${name} and its result?`, 'Delete'))) return
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

/** Notice of a job that ended without a result. */
function endNotice(job: Job) {
  if (job.state === 'canceled') {
    return el('section', { class: 'notice' }, el('h2', {}, 'Canceled'), el('p', {}, 'The job was stopped; it has no result.'),
      el('p', { class: 'remedy' }, el('strong', {}, 'What to do: '), 'start a new job with “Solve again”.'))
  }
  const cause = job.error ?? { code: job.state, detail: 'The job ended without a result.' }
  const remedy = cause.remedy || 'Correct the input, upload it again and start a new job.'
  return causeCard(job.state === 'dead' ? 'The job crashed three times' : 'This session could not be solved', { ...cause, remedy })
}

/** Progress, provisional scene and log of a job without a result. */
class ProgressView {
  private readonly progress = el('div', { role: 'status' })
  private readonly stages = el('ol', { class: 'stages' })
  private readonly lines = el('pre', { class: 'log', tabindex: 0, 'aria-label': 'Log lines' })
  private readonly logBox = el('details', { hidden: true }, el('summary', {}, 'Log'), this.lines)
  private readonly provisional = new ProvisionalView()
  readonly element = el('section', { class: 'waiting', 'aria-label': 'Progress' },
    this.progress, this.provisional.element, this.stages, this.logBox)

  show(job: Job) {
    fill(this.progress, progressBar(job))
    const done = Object.entries(job.stage_seconds)
    if (done.length !== this.stages.childElementCount) {
      fill(this.stages, ...done.map(([stage, time]) => el('li', {}, `${words(stage)}: ${seconds(time)}`)))
    }
  }

  scene(scene: ProvisionalScene) {
    this.provisional.show(scene)
  }

  close() {
    this.provisional.close()
  }

  log(line: string) {
    this.logBox.hidden = false
    this.lines.append(`${line}\n`)
    while (this.lines.childNodes.length > LOG_LINES) this.lines.firstChild?.remove()
  }
}
