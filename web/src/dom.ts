// Creation of DOM elements. Text is always inserted as text, so that names with HTML in them are harmless.

export type Child = Node | string | number | null | undefined | false

type Properties = Record<string, unknown>

/** Creates an element with attributes (also `class` and `data-…`), listeners (`onclick: …`) and children. */
export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  properties: Properties = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  return initialised(document.createElement(tag), properties, children)
}

const SVG = 'http://www.w3.org/2000/svg'

/** Creates an SVG element. */
export function svg<K extends keyof SVGElementTagNameMap>(
  tag: K,
  properties: Properties = {},
  ...children: Child[]
): SVGElementTagNameMap[K] {
  return initialised(document.createElementNS(SVG, tag) as SVGElementTagNameMap[K], properties, children)
}

function initialised<E extends Element>(element: E, properties: Properties, children: Child[]): E {
  for (const [name, value] of Object.entries(properties)) {
    if (value === null || value === undefined || value === false) continue
    if (name.startsWith('on')) element.addEventListener(name.slice(2), value as EventListener)
    else if (name in element && (typeof value === 'boolean' || name === 'value')) Reflect.set(element, name, value)
    else element.setAttribute(name, value === true ? '' : String(value))
  }
  element.append(...children.filter(isShown).map((child) => (child instanceof Node ? child : String(child))))
  return element
}

function isShown(child: Child): child is Node | string | number {
  return child !== null && child !== undefined && child !== false
}

/** Replaces all children of an element. */
export function fill(parent: Element, ...children: Child[]) {
  parent.replaceChildren(...children.filter(isShown).map((child) => (child instanceof Node ? child : String(child))))
}

/** Creates a button with `label` as its text, unless children are given. */
export function button(label: string, onclick: () => void, properties: Properties = {}, ...children: Child[]) {
  return el('button', { type: 'button', onclick, ...properties }, ...(children.length ? children : [label]))
}
