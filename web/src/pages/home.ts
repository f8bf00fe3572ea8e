// Home page: upload of sessions, lists of sessions and jobs.

import { Problem, cancelJob, deleteJob, deleteSession, listJobs, listSessions } from '../api/client'
import { follow, pause } from '../api/follow'
import { type Job, type Session, isFinal } from '../api/types'
import { type Take, takeFromDrop, takeFromFiles, upload } from '../api/upload'
import { button, el, fill } from '../dom'
import { bytes, count, grouped, localTime, percent } from '../format'
import { duration, progressBar, stateChip, verdictChip } from './chips'
import { confirmDeletion } from './dialog'
import { problemCard } from './notice'
import { openStart } from './start'

/** Time between two refreshes of the lists, ms. Progress of running jobs arrives as events. */
const REFRESH_MS = 3000

/** Maximum number of jobs followed at the same time: a browser opens at most six connections to a service. */
const MAX_FOLLOWED = 3

export interface Home {
  element: HTMLElement
}

/** `onproblem` receives problems with the service, and null when it answers again. */
export function openHome(signal: AbortSignal, onproblem: (problem: Problem | null) => void): Home {
  const jobs = el('div', { class: 'jobs' })
  const sessions = el('div', { class: 'sessions' })
  const trouble = el('div', { 'aria-live': 'polite' })
  const followed = new Map<string, Job['state']>()
  let known = ''

  const refresh = async () => {
    const [listed, stored] = await Promise.all([listJobs(signal), listSessions(signal)])
    onproblem(null)
    const now = JSON.stringify([listed.map((job) => ({ ...job, progress: null })), stored])
    if (now !== known) {
      known = now
      keepingFocus(jobs, () => fill(jobs, jobTable(listed, stored, act)))
      keepingFocus(sessions, () => fill(sessions, ...sessionCards(stored, act)))
    }
    listed.filter(({ state }) => !isFinal(state)).forEach(watchJob)
  }
  /** Draws the progress of a job; any other change refreshes the lists. */
  const watchJob = (job: Job) => {
    if (followed.has(job.id) || followed.size >= MAX_FOLLOWED) return
    followed.set(job.id, job.state)
    const onJob = (now: Job) => {
      const progress = jobs.querySelector(`[data-job="${job.id}"] .job-progress`)
      if (progress) fill(progress, progressBar(now))
      const isNew = followed.get(job.id) !== now.state
      followed.set(job.id, now.state)
      if (isNew) refresh().catch(() => {})
    }
    follow(job.id, { onJob, onProblem: () => {} }, signal).finally(() => followed.delete(job.id))
  }
  const act = async (title: string, action: () => Promise<unknown>) => {
    fill(trouble)
    try {
      await action()
      await refresh()
    } catch (error) {
      if (!signal.aborted) fill(trouble, problemCard(title, error))
    }
  }
  const dropped = (take: Take | null) => take && receive(take, zone.status, trouble, act)
  const zone = dropZone(dropped)
  watch(refresh, signal, onproblem)

  const element = el('div', { class: 'home' },
    el('section', { class: 'side', 'aria-label': 'Sessions' }, zone.element, trouble, el('h2', {}, 'Sessions'), sessions),
    el('section', { class: 'main', 'aria-label': 'Jobs' }, el('h2', {}, 'Jobs'), jobs))
  return { element }
}

async function watch(refresh: () => Promise<void>, signal: AbortSignal, onproblem: (problem: Problem) => void) {
  while (!signal.aborted) {
    try {
      await refresh()
    } catch (error) {
      if (signal.aborted) return
      if (!(error instanceof Problem)) throw error
      onproblem(error)
    }
    await pause(REFRESH_MS, signal)
  }
}

type Act = (title: string, action: () => Promise<unknown>) => Promise<void>

function receive(take: Take, status: HTMLElement, trouble: HTMLElement, act: Act) {
  fill(trouble)
  act(`${take.name} was rejected`, async () => {
    try {
      const session = await upload(take, (share) => (status.textContent = `Uploading ${take.name}: ${percent(share)}`))
      openStart(session, (job) => (location.hash = `#/jobs/${job.id}`))
    } finally {
      status.textContent = ''
    }
  })
}

function dropZone(ontake: (take: Take | null) => void) {
  const file = el('input', { type: 'file', accept: '.zip,.json,.ndjson,.jsonl', hidden: true, 'aria-label': 'Session file' })
  const folder = el('input', { type: 'file', webkitdirectory: true, hidden: true, 'aria-label': 'Session folder' })
  for (const input of [file, folder]) {
    input.addEventListener('change', () => {
      ontake(takeFromFiles([...(input.files ?? [])]))
      input.value = ''
    })
  }
  const status = el('p', { class: 'status', role: 'status' })
  const element = el('div', { class: 'drop' },
    el('p', { class: 'drop-title' }, 'Drop a session here'),
    el('p', { class: 'hint' }, 'A folder, a zip file, a JSON document or NDJSON with the 2D poses of all cameras.'),
    el('div', { class: 'actions' }, button('Choose a file', () => file.click()), button('Choose a folder', () => folder.click())),
    status, file, folder)
  // A drop anywhere in the window counts.
  const events = new AbortController()
  const on = (name: string, listener: (event: DragEvent) => void) =>
    window.addEventListener(name, (event) => {
      if (!element.isConnected) return events.abort()
      event.preventDefault()
      listener(event as DragEvent)
    }, { signal: events.signal })
  on('dragover', () => element.classList.add('over'))
  on('dragleave', (event) => event.relatedTarget === null && element.classList.remove('over'))
  on('drop', async (event) => {
    element.classList.remove('over')
    if (event.dataTransfer) ontake(await takeFromDrop(event.dataTransfer))
  })
  return { element, status }
}

function jobTable(jobs: Job[], sessions: Session[], act: Act) {
  if (jobs.length === 0) {
    return el('div', { class: 'empty' }, el('p', {}, 'No jobs yet.'),
      el('p', { class: 'hint' }, 'Drop a session, or choose one and press Solve. `wandless simulate --out take` creates an example.'))
  }
  return el('ul', { class: 'job-list' }, ...jobs.map((job) => jobRow(job, sessions.find(({ id }) => id === job.session), act)))
}

function jobRow(job: Job, session: Session | undefined, act: Act) {
  const name = session?.name ?? job.session
  const labels = Object.entries(job.labels).map(([key, value]) => el('span', { class: 'chip label-chip' }, `${key}: ${value}`))
  return el('li', { class: 'job', 'data-job': job.id },
    el('div', { class: 'job-head' },
      el('a', { href: `#/jobs/${job.id}` }, name),
      stateChip(job), job.quality ? verdictChip(job.quality.verdict) : null, ...labels,
      el('span', { class: 'job-time' }, `${localTime(job.created_at)} · ${duration(job)}`),
      isFinal(job.state)
        ? button('Delete', async () => {
            if (await confirmDeletion(`Delete the job on ${name} and its result?`, 'Delete')) {
              act('The job was not deleted', () => deleteJob(job.id))
            }
          }, { class: 'quiet', 'aria-label': `Delete the job on ${name}` })
        : button('Cancel', () => act('The job was not canceled', () => cancelJob(job.id)), {
            class: 'quiet', disabled: job.state === 'canceling', 'aria-label': `Cancel the job on ${name}` })),
    el('div', { class: 'job-progress' }, progressBar(job)),
    job.error ? el('p', { class: 'job-reason' }, job.error.detail) : null,
    job.quality && job.quality.reasons.length > 0 ? el('p', { class: 'job-reason' }, job.quality.reasons[0]) : null)
}

function sessionCards(sessions: Session[], act: Act) {
  if (sessions.length === 0) return [el('p', { class: 'hint' }, 'None yet.')]
  return sessions.map((session) =>
    el('article', { class: 'session' },
      el('h3', {}, session.name),
      el('p', { class: 'hint' },
        `${count(session.cameras, 'camera')} · ${grouped(session.frames)} frames · up to ${count(session.people_max, 'person', 'people')} · ${session.keypoint_convention} · ${bytes(session.bytes)}`),
      session.warnings.length > 0 &&
        el('details', {}, el('summary', {}, count(session.warnings.length, 'warning')),
          el('ul', {}, ...session.warnings.map((warning) => el('li', {}, warning)))),
      el('div', { class: 'actions' },
        button('Solve', () => openStart(session, (job) => (location.hash = `#/jobs/${job.id}`)), {
          class: 'primary', 'aria-label': `Solve ${session.name}` }),
        button('Delete', async () => {
          if (await confirmDeletion(`Delete the session ${session.name}?`, 'Delete')) {
            act('The session was not deleted', () => deleteSession(session.id))
          }
        }, { class: 'quiet', 'aria-label': `Delete the session ${session.name}` }))))
}

/** Redraws a list and keeps the keyboard focus. */
function keepingFocus(list: HTMLElement, redraw: () => void) {
  const focusable = () => [...list.querySelectorAll<HTMLElement>('a, button, summary')]
  const label = (element: Element | null) => element?.getAttribute('aria-label') ?? element?.textContent
  const focused = list.contains(document.activeElement) ? label(document.activeElement) : null
  redraw()
  if (focused) focusable().find((element) => label(element) === focused)?.focus()
}
