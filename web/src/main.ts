// Entry point: selects the page for the address, switches the theme and shows connection problems.

import { Problem } from './api/client'
import { button, el, fill } from './dom'
import { openHome } from './pages/home'
import { type JobPage, type Tab, openJob } from './pages/job'
import { askForKey } from './pages/key'
import { causeCard, problemCard } from './pages/notice'
import { isDark, onThemeChange, startTheme, toggleTheme } from './theme'

startTheme()
const banner = el('div', { class: 'banner', 'aria-live': 'assertive' })
const page = el('main', {})
const theme = button('', toggleTheme, { class: 'quiet' })
const labelTheme = () => (theme.textContent = isDark() ? 'Light' : 'Dark')
onThemeChange(labelTheme)
labelTheme()

document.getElementById('app')!.append(
  el('header', { class: 'top' },
    el('a', { class: 'brand', href: '#/' }, 'wandless'),
    el('nav', { 'aria-label': 'Pages' }, el('a', { href: '#/' }, 'Sessions and jobs')),
    theme),
  banner,
  page,
)

let closing = new AbortController()
let open: { id: string; page: JobPage } | null = null

function route() {
  // What follows the question mark is read by the scene.
  const [, kind, id, tab = 'scene'] = location.hash.split('?')[0].split('/')
  if (kind === 'jobs' && id && open?.id === id) return open.page.show(tab as Tab)
  closing.abort()
  closing = new AbortController()
  const { signal } = closing
  open = null
  if (kind === 'jobs' && id) {
    open = { id, page: openJob(encodeURIComponent(id), tab as Tab, signal, showProblem) }
    fill(page, open.page.element)
  } else {
    document.title = 'wandless'
    fill(page, openHome(signal, showProblem).element)
  }
}

/** Shows a problem with the service at the top of every page; null removes it. */
function showProblem(problem: Problem | null) {
  if (problem?.status === 401 || problem?.status === 403) askForKey(restart)
  if (!problem) return fill(banner)
  if (problem.status === 401) {
    const cause = { code: 'key_needed', detail: 'This service requires an API key.', remedy: 'Enter the key; the operator creates one with `wandless key create`.' }
    return fill(banner, causeCard('API key required', cause), button('Enter the key', () => askForKey(restart)))
  }
  fill(banner, problemCard(problem.status === 0 ? 'No connection' : 'The service could not answer', problem))
}

function restart() {
  open = null
  route()
}

window.addEventListener('hashchange', route)
route()
