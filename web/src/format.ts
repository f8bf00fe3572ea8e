// Formatting of numbers with units and a sensible number of digits.

const THIN = '\u202f'
export const NOTHING = '–'

export function px(value: number | null | undefined, digits = 1) {
  return withUnit(value, digits, 'px')
}

export function millimetres(value: number | null | undefined) {
  return withUnit(value, value != null && value < 10 ? 1 : 0, 'mm')
}

export function metres(value: number | null | undefined, digits = 2) {
  return withUnit(value, digits, 'm')
}

export function degrees(value: number | null | undefined) {
  return withUnit(value, 2, '°', '')
}

export function percent(share: number | null | undefined, digits = 0) {
  return withUnit(share == null ? share : 100 * share, digits, '%')
}

export function acceleration(value: number | null | undefined) {
  return withUnit(value, 1, 'm/s²')
}

export function seconds(value: number | null | undefined) {
  if (value == null || !Number.isFinite(value)) return NOTHING
  if (value < 60) return withUnit(value, value < 10 ? 1 : 0, 's')
  const minutes = Math.floor(value / 60)
  return `${minutes}${THIN}min ${Math.round(value % 60)}${THIN}s`
}

export function bytes(value: number) {
  const units = ['B', 'kB', 'MB', 'GB']
  let unit = 0
  while (value >= 1000 && unit < 3) [value, unit] = [value / 1000, unit + 1]
  return withUnit(value, unit === 0 || value >= 100 ? 0 : 1, units[unit])
}

export function count(n: number, one: string, many = `${one}s`) {
  return `${grouped(n)} ${n === 1 ? one : many}`
}

export function grouped(n: number) {
  return Math.round(n).toString().replace(/\B(?=(\d{3})+$)/g, THIN)
}

/** A time in the local time zone. */
export function localTime(text: string | null) {
  if (!text) return NOTHING
  const at = new Date(text)
  const isToday = at.toDateString() === new Date().toDateString()
  const time = at.toLocaleTimeString([], { hour: '2-digit', minute: '2-digit' })
  return isToday ? `today ${time}` : `${at.toLocaleDateString()} ${time}`
}

/** An identifier as words: `body_fit` becomes `body fit`. */
export function words(name: string) {
  return name.replaceAll('_', ' ')
}

function withUnit(value: number | null | undefined, digits: number, unit: string, space = THIN) {
  if (value == null || !Number.isFinite(value)) return NOTHING
  return `${value.toFixed(digits)}${space}${unit}`
}
