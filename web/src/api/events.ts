// Server-sent events read with `fetch`, because `EventSource` cannot send the API key.

export interface ServerEvent {
  name: string
  data: string
  id: string | null
}

/** A stream without data for this time is broken, ms. The service sends a comment every 10 s. */
const TIMEOUT_MS = 25_000

/** Yields the events of a response; ends with the stream or after `TIMEOUT_MS` without data. */
export async function* eventsOf(response: Response): AsyncGenerator<ServerEvent> {
  const reader = response.body?.getReader()
  if (!reader) return
  const decoder = new TextDecoder()
  let text = ''
  try {
    for (;;) {
      const portion = await within(reader.read(), TIMEOUT_MS)
      if (!portion || portion.done) return
      text += decoder.decode(portion.value, { stream: true }).replaceAll('\r', '')
      const blocks = text.split('\n\n')
      text = blocks.pop() ?? ''
      for (const block of blocks) {
        const event = eventOf(block)
        if (event) yield event
      }
    }
  } finally {
    reader.cancel().catch(() => {})
  }
}

/** Parses one block of lines; null for a keep-alive comment. */
function eventOf(block: string): ServerEvent | null {
  const event: ServerEvent = { name: 'message', data: '', id: null }
  for (const line of block.split('\n')) {
    const [, field, value] = /^([a-z]+): ?(.*)$/.exec(line) ?? []
    if (field === 'event') event.name = value
    if (field === 'id') event.id = value
    if (field === 'data') event.data += (event.data && '\n') + value
  }
  return event.data ? event : null
}

/** Result of a promise, or null after `ms`. */
function within<T>(promise: Promise<T>, ms: number): Promise<T | null> {
  let timer = 0
  const timeout = new Promise<null>((resolve) => (timer = window.setTimeout(() => resolve(null), ms)))
  return Promise.race([promise, timeout]).finally(() => clearTimeout(timer))
}
