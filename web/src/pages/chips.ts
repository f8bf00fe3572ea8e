// Chips for job states and verdicts, and the progress bar of a job.

import type { Job, Verdict } from '../api/types'
import { el } from '../dom'
import { NOTHING, percent, seconds, words } from '../format'

export function stateChip(job: Job) {
  return el('span', { class: `chip state-${job.state}` }, job.state)
}

export function verdictChip(verdict: Verdict) {
  const text = { pass: 'pass', warn: 'check before use', reject: 'do not use' }[verdict]
  return el('span', { class: `chip verdict-${verdict}` }, text)
}

/** Progress bar with the current stage; null once the job has ended. */
export function progressBar(job: Job) {
  if (!['queued', 'running', 'canceling'].includes(job.state)) return null
  const progress = job.progress ?? { stage: '', stage_index: 0, stage_count: 0, fraction: 0, message: '', eta_s: null }
  const stage = progress.stage ? words(progress.stage) : job.state
  const eta = progress.eta_s == null ? '' : ` · ${seconds(progress.eta_s)} left`
  const bar = el('progress', { max: 1, value: progress.fraction, 'aria-label': `Progress, ${stage}` })
  const step = progress.stage ? `${progress.stage_index + 1} of ${progress.stage_count}: ` : ''
  return el('div', { class: 'progress' }, bar,
    el('span', {}, `${percent(progress.fraction)} · ${step}${stage}${progress.message ? ` · ${progress.message}` : ''}${eta}`))
}

export function duration(job: Job) {
  if (!job.started_at) return NOTHING
  const end = job.finished_at ? Date.parse(job.finished_at) : Date.now()
  return seconds((end - Date.parse(job.started_at)) / 1000)
}
