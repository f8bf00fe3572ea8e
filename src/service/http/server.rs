//! The accept loop: hyper's http1 with the timeouts that `axum::serve` lacks.
//!
//! A connection is closed after `header_timeout` without a complete first request head, after `keep_alive` without a complete
//! further head, and after `write_timeout` if the client does not read its answer; [`super::body`] ends stalled uploads. At most
//! `max_connections` are open. HTTP/2 is not offered, because hyper has no header timeout for it.

use crate::service::failpoint::fault;
use crate::service::metrics::Metrics;
use crate::service::settings::RequestLimits;
use axum::Router;
use hyper::body::Incoming;
use hyper::server::conn::http1;
use hyper_util::rt::{TokioIo, TokioTimer};
use hyper_util::service::TowerToHyperService;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{Notify, Semaphore};
use tokio::task::JoinSet;
use tokio::time::{Instant, Sleep};
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

/// Address of the client of a connection.
#[derive(Debug, Clone, Copy)]
pub(super) struct Peer(pub(super) SocketAddr);

/// Time between two attempts to accept a connection, for example after the process ran out of file descriptors.
const ACCEPT_RETRY: Duration = Duration::from_millis(100);

/// Serves until `draining` is cancelled; then accepts no more connections and gives open requests `drain_limit` to end.
pub(super) async fn serve(
    listener: TcpListener,
    router: Router,
    limits: &RequestLimits,
    drain_limit: Duration,
    metrics: Arc<Metrics>,
    draining: CancellationToken,
) {
    let slots = Arc::new(Semaphore::new(limits.max_connections));
    let mut connections = JoinSet::new();
    loop {
        let slot = tokio::select! {
            slot = slots.clone().acquire_owned() => slot,
            () = draining.cancelled() => break,
        };
        let (stream, peer) = tokio::select! {
            accepted = listener.accept() => match accepted {
                Ok(accepted) => accepted,
                Err(error) => {
                    tracing::warn!(%error, "a connection could not be accepted");
                    tokio::time::sleep(ACCEPT_RETRY).await;
                    continue;
                }
            },
            () = draining.cancelled() => break,
        };
        let connection = serve_connection(stream, Peer(peer), router.clone(), limits.clone(), draining.clone());
        let metrics = metrics.clone();
        connections.spawn(async move {
            metrics.connections.inc();
            connection.await;
            metrics.connections.dec();
            drop(slot);
        });
        while connections.try_join_next().is_some() {} // forget ended connections
    }
    drop(listener);
    let drain_limit = if fault("stop.endless") { Duration::MAX } else { drain_limit };
    let ended = async { while connections.join_next().await.is_some() {} };
    if tokio::time::timeout(drain_limit, ended).await.is_err() {
        tracing::warn!("closing connections that are still open after the drain limit");
    }
    connections.shutdown().await;
}

async fn serve_connection(
    stream: TcpStream,
    peer: Peer,
    router: Router,
    limits: RequestLimits,
    draining: CancellationToken,
) {
    let _ = stream.set_nodelay(true); // avoids delays of small answers; an error only keeps the delay
    let io = TokioIo::new(TimedStream::new(stream, limits.write_timeout));
    let got_request = Arc::new(Notify::new());
    let request_seen = got_request.clone();
    let service = TowerToHyperService::new(router.map_request(move |mut request: hyper::Request<Incoming>| {
        request_seen.notify_one();
        request.extensions_mut().insert(peer);
        request
    }));
    let connection = http1::Builder::new()
        .timer(TokioTimer::new())
        .header_read_timeout(limits.keep_alive.max(limits.header_timeout))
        .max_buf_size(64 << 10)
        .serve_connection(io, service);
    let mut connection = std::pin::pin!(connection);
    let first_head = tokio::time::timeout(limits.header_timeout, got_request.notified());
    tokio::select! {
        _ = connection.as_mut() => return,
        first_head = first_head => if first_head.is_err() { return },
        () = draining.cancelled() => {}
    }
    let result = tokio::select! {
        result = connection.as_mut() => result,
        () = draining.cancelled() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = result {
        tracing::debug!(%error, "connection ended early");
    }
}

/// A stream that fails if the peer takes no byte for `write_timeout`.
struct TimedStream {
    stream: TcpStream,
    write_timeout: Duration,
    /// Set while a write waits.
    deadline: Option<Pin<Box<Sleep>>>,
}

impl TimedStream {
    fn new(stream: TcpStream, write_timeout: Duration) -> Self {
        Self { stream, write_timeout, deadline: None }
    }

    /// Returns the result of a write; a pending write becomes an error after the timeout.
    fn timed<T>(&mut self, cx: &mut Context<'_>, written: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if written.is_ready() {
            self.deadline = None;
            return written;
        }
        let end = Instant::now() + self.write_timeout;
        let deadline = self.deadline.get_or_insert_with(|| Box::pin(tokio::time::sleep_until(end)));
        deadline.as_mut().poll(cx).map(|()| Err(io::ErrorKind::TimedOut.into()))
    }
}

impl AsyncRead for TimedStream {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buffer: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, buffer)
    }
}

impl AsyncWrite for TimedStream {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(cx, bytes);
        self.timed(cx, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        slices: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(cx, slices);
        self.timed(cx, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        let flushed = Pin::new(&mut self.stream).poll_flush(cx);
        self.timed(cx, flushed)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}
