// Inputs for the options of a job, built from the table of options that the program documents everywhere.

import type { Session } from '../api/types'
import table from '../data/options.json'
import { el } from '../dom'

interface Choice {
  value: string
  meaning: string
}

interface Field {
  name: string
  kind: string
  unit: string
  effect: string
  min?: number
  max?: number | null
}

interface Form {
  from: string
  meaning: string
  fields: Field[]
}

/** One row of the table; `values` and `forms` belong to some kinds only. */
interface Option extends Field {
  label: string
  default: unknown
  common: boolean
  values?: Choice[]
  forms?: Form[]
}

/** An input and its value; undefined stands for the default. */
interface Input {
  element: HTMLElement
  value: () => unknown
}

export interface OptionInputs {
  element: HTMLElement
  /** The options that differ from their defaults. */
  values: () => Record<string, unknown>
}

/** Corrections belong to a result, whose page has an editor for them. */
const OPTIONS = (table as Option[]).filter(({ kind }) => kind !== 'actions')

export function optionInputs(session: Session): OptionInputs {
  const inputs = OPTIONS.map((option) => ({ option, input: inputOf(option, session) }))
  const elements = (isWanted: (option: Option) => boolean) =>
    inputs.filter(({ option }) => isWanted(option)).map(({ input }) => input.element)
  const element = el('div', { class: 'options' },
    ...elements((option) => option.common),
    el('details', {}, el('summary', {}, 'More options'),
      el('div', { class: 'options' }, ...elements(({ common, kind }) => !common && kind !== 'choices'))),
    ...elements(({ common, kind }) => !common && kind === 'choices'))
  const values = () => Object.fromEntries(inputs
    .map(({ option, input }) => [option.name, input.value()] as const)
    .filter(([, value]) => value !== undefined))
  return { element, values }
}

function inputOf(option: Option, session: Session): Input {
  if (option.kind === 'switch') return switchInput(option)
  if (option.kind === 'choice') return choiceInput(option, session)
  if (option.kind === 'choices') return choicesInput(option)
  if (option.kind === 'forms') return formsInput(option, session)
  return plainInput(option)
}

function plainInput(option: Option): Input {
  const input = numberOrText(option, option.name)
  input.placeholder = option.default === null ? 'not given' : String(option.default)
  const unit = option.unit ? `${option.label}, ${option.unit}` : option.label
  return { element: labelled(unit, input, option.effect), value: () => valueOf(input) }
}

function switchInput(option: Option): Input {
  const input = el('input', { type: 'checkbox', checked: option.default === true })
  const element = el('label', { class: 'check', title: plain(option.effect) }, input, option.label)
  return { element, value: () => (input.checked === option.default ? undefined : input.checked) }
}

function choiceInput(option: Option, session: Session): Input {
  const hasPoses = session.camera_facts.every((camera) => camera.has_extrinsics)
  // Poses that the session does not give can be neither kept nor refined.
  const isPossible = ({ value }: Choice) => option.name !== 'extrinsics' || hasPoses || value === option.default
  const choices = (option.values ?? []).filter(isPossible)
  const select = el('select', { id: option.name, title: plain(option.effect) },
    ...choices.map(({ value }) => el('option', { value }, words(value))))
  select.value = String(option.default)
  return {
    element: withMeaning(option.label, select, choices),
    value: () => (select.value === option.default ? undefined : select.value),
  }
}

function choicesInput(option: Option): Input {
  const chosen = option.default as string[]
  const boxes = (option.values ?? []).map(({ value, meaning }) => {
    const input = el('input', { type: 'checkbox', checked: chosen.includes(value) })
    return { value, input, element: el('label', { class: 'check', title: meaning }, input, value) }
  })
  const element = el('details', {}, el('summary', {}, option.label),
    el('div', { class: 'grid' }, ...boxes.map(({ element }) => element)))
  return { element, value: () => boxes.filter(({ input }) => input.checked).map(({ value }) => value) }
}

function formsInput(option: Option, session: Session): Input {
  const initial = (option.default as { from: string }).from
  const select = el('select', { id: option.name, title: plain(option.effect) },
    ...(option.forms ?? []).map(({ from }) => el('option', { value: from }, words(from))))
  select.value = initial
  const meanings = (option.forms ?? []).map(({ from, meaning }) => ({ value: from, meaning }))
  const forms = (option.forms ?? []).map((form) => {
    const fields = form.fields.map((field) => fieldInput(form, field, session))
    const element = el('div', { class: 'options', hidden: form.from !== initial }, ...fields.map(({ element }) => element))
    return { form, fields, element }
  })
  select.addEventListener('change', () => forms.forEach(({ form, element }) => (element.hidden = form.from !== select.value)))
  const value = () => {
    const chosen = forms.find(({ form }) => form.from === select.value)
    if (!chosen || select.value === initial) return undefined
    const values = chosen.fields.map(({ value }, index) => [chosen.form.fields[index].name, value()])
    return { from: chosen.form.from, ...Object.fromEntries(values) }
  }
  return { element: el('div', { class: 'options' }, withMeaning(option.label, select, meanings), ...forms.map(({ element }) => element)), value }
}

function fieldInput(form: Form, field: Field, session: Session): Input {
  const id = `${form.from}-${field.name}`
  const label = `${words(field.name)}${field.unit ? `, ${field.unit}` : ''}`
  if (field.kind === 'two_cameras') {
    const selects = [0, 1].map((n) => {
      const select = el('select', { id: `${id}-${n}`, 'aria-label': `${words(field.name)} ${n + 1}` },
        ...session.camera_facts.map(({ id: camera }) => el('option', { value: camera }, camera)))
      select.selectedIndex = Math.min(n, session.camera_facts.length - 1)
      return select
    })
    const element = el('div', { class: 'field' }, el('span', {}, label), ...selects)
    return { element, value: () => selects.map(({ value }) => value) }
  }
  const input = numberOrText(field, id)
  if (field.kind === 'text') input.value = 'tallest' // the person of a known height, unless a track id is entered
  return { element: labelled(label, input, field.effect), value: () => valueOf(input) }
}

function numberOrText({ kind, min, max }: Field, id: string): HTMLInputElement {
  if (kind === 'text') return el('input', { type: 'text', id })
  return el('input', { type: 'number', id, min, max, step: kind === 'whole' ? 1 : 'any' })
}

function valueOf(input: HTMLInputElement): unknown {
  if (!input.value) return undefined
  return input.type === 'number' ? Number(input.value) : input.value
}

/** A selection with the meaning of the chosen value below it. */
function withMeaning(label: string, select: HTMLSelectElement, choices: Choice[]) {
  const hint = el('span', { class: 'hint', 'aria-live': 'polite' })
  const show = () => (hint.textContent = plain(choices.find(({ value }) => value === select.value)?.meaning ?? ''))
  select.addEventListener('change', show)
  show()
  const element = labelled(label, select)
  element.append(hint)
  return element
}

/** Text of the table without the marks of code. */
function plain(text: string) {
  return text.replaceAll('`', '')
}

function words(name: string) {
  return name.replaceAll('_', ' ')
}

function labelled(label: string, input: HTMLElement, hint?: string) {
  return el('div', { class: 'field' }, el('label', { for: input.id }, label), input, hint ? el('span', { class: 'hint' }, plain(hint)) : null)
}
