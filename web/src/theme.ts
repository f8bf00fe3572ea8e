// Dark and light theme: the system setting unless the user has chosen one.

const NAME = 'wandless.theme'
const listeners = new Set<() => void>()
const isLightSystem = matchMedia('(prefers-color-scheme: light)')

export function startTheme() {
  apply()
  isLightSystem.addEventListener('change', apply)
}

export function isDark() {
  const chosen = localStorage.getItem(NAME)
  return chosen ? chosen === 'dark' : !isLightSystem.matches
}

export function toggleTheme() {
  localStorage.setItem(NAME, isDark() ? 'light' : 'dark')
  apply()
}

/** Calls `listener` at every change; returns a function that unsubscribes. */
export function onThemeChange(listener: () => void) {
  listeners.add(listener)
  return () => void listeners.delete(listener)
}

function apply() {
  document.documentElement.dataset.theme = isDark() ? 'dark' : 'light'
  listeners.forEach((listener) => listener())
}
