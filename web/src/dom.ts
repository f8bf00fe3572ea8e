// The one way elements are made. Text goes in as text: a name with HTML in it stays a name.

export type Child = Node | string | number | null | undefined | false

type Properties = Record<string, unknown>

/** An element with attributes, listeners (`onclick: …`) and children; `class` and `data-…` are attributes as they stand. */
export function el<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  properties: Properties = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  return dressed(document.createElement(tag), properties, children)
}

const SVG = 'http://www.w3.org/2000/svg'

/** The same for SVG. */
export function svg<K extends keyof SVGElementTagNameMap>(
  tag: K,
  properties: Properties = {},
  ...children: Child[]
): SVGElementTagNameMap[K] {
  return dressed(document.createElementNS(SVG, tag) as SVGElementTagNameMap[K], properties, children)
}

function dressed<E extends Element>(element: E, properties: Properties, children: Child[]): E {
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

/** Puts new children in place of the old ones. */
export function fill(parent: Element, ...children: Child[]) {
  parent.replaceChildren(...children.filter(isShown).map((child) => (child instanceof Node ? child : String(child))))
}

/** A button; its label is read out even where only a sign is shown. */
export function button(label: string, onclick: () => void, properties: Properties = {}, ...children: Child[]) {
  return el('button', { type: 'button', onclick, ...properties }, ...(children.length ? children : [label]))
}
