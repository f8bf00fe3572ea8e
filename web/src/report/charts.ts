// Bar charts and line charts as SVG, on screen and for printing.

import { el, svg } from '../dom'

const WIDTH = 540

/** One bar per row with its value; `mark` is drawn as a tick (the mean beside the median). */
export function barChart(title: string, unit: string, rows: { name: string; value: number | null; mark?: number | null; note?: string }[]) {
  const [row, left, right] = [26, 110, 90]
  const most = Math.max(...rows.map(({ value, mark }) => Math.max(value ?? 0, mark ?? 0)), 1e-9) * 1.02
  const x = (value: number) => left + (value / most) * (WIDTH - left - right)
  const height = rows.length * row + 8
  const bars = rows.flatMap(({ name, value, mark, note }, i) => {
    const middle = 4 + i * row + row / 2
    return [
      svg('text', { x: left - 10, y: middle, class: 'chart-name', 'text-anchor': 'end' }, shortened(name)),
      value !== null && svg('rect', { x: left, y: middle - 7, width: Math.max(x(value) - left, 1), height: 14, rx: 2, class: 'chart-bar' }),
      mark != null && svg('line', { x1: x(mark), x2: x(mark), y1: middle - 9, y2: middle + 9, class: 'chart-mark' }),
      svg('text', { x: x(Math.max(value ?? 0, mark ?? 0)) + 8, y: middle, class: 'chart-number' },
        value === null ? (note ?? 'none') : `${value.toFixed(2)} ${unit}`),
    ]
  })
  return figure(title, svg('svg', { viewBox: `0 0 ${WIDTH} ${height}`, role: 'img', 'aria-label': title }, ...bars))
}

/** Lines over frames; NaN interrupts a line. `start`: number of the first frame. */
export function lineChart(title: string, unit: string, start: number, lines: { name: string; color: string; values: Float32Array }[]) {
  const [height, left, bottom, top] = [190, 46, 24, 8]
  const n = Math.max(...lines.map(({ values }) => values.length), 2)
  const all = lines.flatMap(({ values }) => Array.from(values).filter(Number.isFinite)).sort((a, b) => a - b)
  // The scale ends slightly above the 99.5th percentile, so that single spikes do not flatten the rest.
  const most = niceAbove((all[Math.floor(0.995 * (all.length - 1))] ?? 1) * 1.05)
  const x = (i: number) => left + (i / (n - 1)) * (WIDTH - left - 8)
  const y = (value: number) => top + (1 - Math.min(value / most, 1)) * (height - top - bottom)
  const levels = [0, 0.25, 0.5, 0.75, 1].map((share) => share * most)
  const ticks = [0, 0.25, 0.5, 0.75, 1].map((share) => Math.round(share * (n - 1)))
  const chart = svg('svg', { viewBox: `0 0 ${WIDTH} ${height}`, role: 'img', 'aria-label': `${title}, ${unit} over frames` },
    ...levels.map((level) => svg('line', { x1: left, x2: WIDTH - 8, y1: y(level), y2: y(level), class: 'chart-grid' })),
    ...levels.map((level) => svg('text', { x: left - 6, y: y(level), class: 'chart-tick', 'text-anchor': 'end' }, String(+level.toPrecision(3)))),
    ...ticks.map((tick, i) => svg('text', { x: x(tick), y: height - 8, class: 'chart-tick', 'text-anchor': i === 0 ? 'start' : i === 4 ? 'end' : 'middle' }, String(start + tick))),
    ...lines.map(({ color, values }) => svg('path', { d: pathOf(smoothed(values), x, y), class: 'chart-line', stroke: color })))
  const legend = el('div', { class: 'chart-legend' }, ...lines.map(({ name, color }) => {
    const swatch = el('span', { class: 'swatch' })
    swatch.style.background = color
    return el('span', {}, swatch, name)
  }))
  return figure(`${title}, ${unit}`, chart, legend)
}

function figure(title: string, ...children: Element[]) {
  return el('figure', { class: 'chart' }, el('figcaption', {}, title), ...children)
}

/** Moving average over about 1 % of the frames. */
function smoothed(values: Float32Array) {
  const half = Math.floor(values.length / 200)
  return Float32Array.from(values, (value, i) => {
    if (!Number.isFinite(value)) return NaN
    let [sum, n] = [0, 0]
    for (let j = Math.max(0, i - half); j <= Math.min(values.length - 1, i + half); j++) {
      if (Number.isFinite(values[j])) [sum, n] = [sum + values[j], n + 1]
    }
    return sum / n
  })
}

function pathOf(values: Float32Array, x: (i: number) => number, y: (value: number) => number) {
  let path = ''
  values.forEach((value, i) => {
    if (!Number.isFinite(value)) return
    path += `${i > 0 && Number.isFinite(values[i - 1]) ? 'L' : 'M'}${x(i).toFixed(1)} ${y(value).toFixed(1)}`
  })
  return path
}

function niceAbove(value: number) {
  const power = 10 ** Math.floor(Math.log10(Math.max(value, 1e-6)))
  return [1, 2, 4, 5, 8, 10].map((step) => step * power).find((step) => step >= value) ?? value
}

function shortened(name: string) {
  return name.length > 13 ? `${name.slice(0, 12)}…` : name
}
