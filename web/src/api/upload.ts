// Upload of a dropped or chosen file or folder.

import { zipSync } from 'fflate'
import { authorization, problemFrom, unreachable } from './client'
import type { Session } from './types'

/** Files to upload: one file, or the files of a folder with their paths. */
export interface Take {
  name: string
  files: { path: string; file: File }[]
}

/** Files of a drop event; folders are read recursively. */
export async function takeFromDrop(transfer: DataTransfer): Promise<Take | null> {
  const entries = [...transfer.items].map((item) => item.webkitGetAsEntry?.()).filter((entry) => entry != null)
  if (entries.length === 0) return takeFromFiles([...transfer.files])
  const files = (await Promise.all(entries.map((entry) => filesBelow(entry, '')))).flat()
  return files.length ? { name: entries[0].name, files } : null
}

/** Files chosen in a file dialogue. */
export function takeFromFiles(files: File[]): Take | null {
  if (files.length === 0) return null
  const listed = files.map((file) => ({ path: file.webkitRelativePath || file.name, file }))
  return { name: listed[0].path.split('/')[0], files: listed }
}

async function filesBelow(entry: FileSystemEntry, folder: string): Promise<Take['files']> {
  const path = folder + entry.name
  if (entry.isFile) {
    const file = await new Promise<File>((resolve, reject) => (entry as FileSystemFileEntry).file(resolve, reject))
    return [{ path, file }]
  }
  const reader = (entry as FileSystemDirectoryEntry).createReader()
  const children: FileSystemEntry[] = []
  for (;;) {
    // The entries of a folder arrive in batches; an empty batch ends the list.
    const batch = await new Promise<FileSystemEntry[]>((resolve, reject) => reader.readEntries(resolve, reject))
    if (batch.length === 0) break
    children.push(...batch)
  }
  return (await Promise.all(children.map((child) => filesBelow(child, `${path}/`)))).flat()
}

/** Uploads a take; `onProgress` receives the uploaded share, 0 to 1. */
export async function upload(take: Take, onProgress: (share: number) => void): Promise<Session> {
  const only = take.files.length === 1 ? take.files[0].file : null
  const type = only && mediaType(only.name)
  if (only && type) return send(only, type, onProgress)
  return send(new Blob([await zipped(take)]), 'application/zip', onProgress)
}

function mediaType(name: string) {
  if (/\.zip$/i.test(name)) return 'application/zip'
  if (/\.json$/i.test(name)) return 'application/json'
  if (/\.(ndjson|jsonl)$/i.test(name)) return 'application/x-ndjson'
  return null
}

async function zipped(take: Take): Promise<Uint8Array<ArrayBuffer>> {
  // Ground truth and images are not uploaded.
  const isWanted = (path: string) => !/(^|\/)gt\//.test(path) && !/\.(jpe?g|png|mp4|mov)$/i.test(path)
  const members: Record<string, Uint8Array> = {}
  for (const { path, file } of take.files.filter(({ path }) => isWanted(path))) {
    members[path] = new Uint8Array(await file.arrayBuffer())
  }
  // The asynchronous `zip` uses workers from blobs, which the content security policy forbids.
  return zipSync(members, { level: 1 }) as Uint8Array<ArrayBuffer>
}

/** Uses XMLHttpRequest, because `fetch` does not report upload progress. */
function send(body: Blob, type: string, onProgress: (share: number) => void): Promise<Session> {
  return new Promise((resolve, reject) => {
    const request = new XMLHttpRequest()
    request.open('POST', '/v1/sessions')
    request.setRequestHeader('Content-Type', type)
    for (const [name, value] of Object.entries(authorization())) request.setRequestHeader(name, value)
    request.upload.onprogress = (event) => onProgress(event.total ? event.loaded / event.total : 0)
    request.onerror = () => reject(unreachable())
    request.onload = () => {
      if (request.status >= 200 && request.status < 300) resolve(JSON.parse(request.responseText))
      else reject(problemFrom(request.status, request.responseText))
    }
    request.send(body)
  })
}
