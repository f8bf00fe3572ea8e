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
  const drawHead = () => job && fill(head, ...headOf(job, name || job.session, act))
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
    drawHead()
    tabs.hidden = now.state !== 'succeeded'
    if (now.state === 'succeeded') show(tab)
    else fill(body, ...waitingPage(now))
  }
  fill(tabs, ...TABS.map(([key, label]) => el('a', { href: `#/jobs/${id}/${key}`, 'data-tab': key }, label)))
  follow(id, (now) => {
    if (!job) getSession(now.session, signal).then((session) => ((name = session.name), changed(job ?? now)), () => {})
    changed(now)
  }, (problem) => {
    if (problem?.status === 404) fill(body, problemCard('There is no such job', problem))
    else onproblem(problem)
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

function headOf(job: Job, name: string, act: (title: string, action: () => Promise<unknown>) => void) {
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
    el('span', { class: 'job-time' }, `${moment(job.created_at)} · ${duration(job)}`),
    isFinal(job.state)
      ? button('Solve again', again, { class: 'quiet' })
      : button('Cancel', () => act('The job was not canceled', () => cancelJob(job.id)), { disabled: job.state === 'canceling' }),
    isFinal(job.state) && button('Delete', remove, { class: 'quiet' }),
  ]
}

/** What is shown until there is a result, or in place of one. */
function waitingPage(job: Job) {
  if (job.state === 'failed' || job.state === 'dead') {
    const cause = job.error ?? { code: job.state, detail: 'The job ended without a result.' }
    const remedy = cause.remedy || 'Mend the input, upload it and start a new job; this one keeps its end.'
    return [causeCard(job.state === 'dead' ? 'The job died three times' : 'This capture could not be solved', { ...cause, remedy })]
  }
  if (job.state === 'canceled') {
    return [el('section', { class: 'notice' }, el('h3', {}, 'Canceled'), el('p', {}, 'The work has stopped and nothing was kept.'),
      el('p', { class: 'remedy' }, el('strong', {}, 'What to do: '), 'start it again with “Solve again”.'))]
  }
  const done = Object.entries(job.stage_seconds)
  return [
    el('section', { class: 'waiting', 'aria-label': 'Progress' },
      progressBar(job),
      done.length > 0 && el('ol', { class: 'stages' }, ...done.map(([stage, time]) => el('li', {}, `${words(stage)}: ${seconds(time)}`)))),
  ]
}
