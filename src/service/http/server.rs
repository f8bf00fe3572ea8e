//! The accept loop: hyper's http1 with the limits that `axum::serve` lacks.
//!
//! [`super::connections`] closes a connection that is idle for too long or in the way of others, [`super::body`] ends stalled
//! uploads, and a connection whose client does not read its answer is closed after `write_timeout`. HTTP/2 is not offered,
//! because hyper has no header timeout for it.

use super::connections::{Connection, Connections, Pending};
use crate::service::failpoint::fault;
use crate::service::metrics::Metrics;
use crate::service::settings::RequestLimits;
use crate::service::webhooks::Networks;
use axum::Router;
use axum::body::{Body, Bytes};
use axum::http::{HeaderValue, header};
use hyper::body::{Frame, Incoming, SizeHint};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper_util::rt::TokioIo;
use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinSet;
use tokio::time::{Instant, Sleep};
use tokio_util::sync::CancellationToken;
use tower::ServiceExt;

/// The connection of a request and the address of its client.
#[derive(Clone)]
pub(super) struct Peer {
    pub(super) address: SocketAddr,
    pub(super) connection: Connection,
}

/// Time between two attempts to accept a connection, for example after the process ran out of file descriptors.
const ACCEPT_RETRY: Duration = Duration::from_millis(100);

/// How a server stops. While it is draining it serves on for `grace` and closes each connection with its next answer: a proxy that holds
/// connections open would send requests into those that are closed at once, and repeats only requests that change nothing.
pub(super) struct Stop {
    pub(super) draining: CancellationToken,
    pub(super) grace: Duration,
    /// Longest time for open requests after that.
    pub(super) limit: Duration,
}

/// Serves until the service drains and the grace is over; then accepts no more connections and lets open requests end.
pub(super) async fn serve(
    listener: TcpListener,
    router: Router,
    limits: &RequestLimits,
    max_connections: usize,
    proxies: Arc<Networks>,
    metrics: Arc<Metrics>,
    stop: Stop,
) {
    let stops = [stop.draining, CancellationToken::new()];
    let [draining, closing] = &stops;
    let connections = Connections::new(limits.clone(), max_connections);
    let mut tasks = JoinSet::new();
    let accepting = async {
        for id in 0.. {
            let (stream, address) = accepted(&listener).await;
            let connection = connections.enter(id, address.ip(), proxies.contain(address.ip())).await;
            let peer = Peer { address, connection: connection.clone() };
            let served = serve_connection(stream, peer, router.clone(), limits.write_timeout, stops.clone());
            let metrics = metrics.clone();
            tasks.spawn(async move {
                metrics.connections.inc();
                served.await;
                metrics.connections.dec();
                connection.end();
            });
            while tasks.try_join_next().is_some() {} // forget ended connections
        }
    };
    tokio::select! {
        () = accepting => {}
        () = connections.sweep() => {}
        () = async { draining.cancelled().await; tokio::time::sleep(stop.grace).await } => {}
    }
    closing.cancel();
    drop(listener);
    let drain_limit = if fault("stop.endless") { Duration::MAX } else { stop.limit };
    let ended = async { while tasks.join_next().await.is_some() {} };
    if tokio::time::timeout(drain_limit, ended).await.is_err() {
        tracing::warn!("closing connections that are still open after the drain limit");
    }
    tasks.shutdown().await;
}

/// The next connection.
async fn accepted(listener: &TcpListener) -> (TcpStream, SocketAddr) {
    loop {
        match listener.accept().await {
            Ok(accepted) => return accepted,
            Err(error) => tracing::warn!(%error, "a connection could not be accepted"),
        }
        tokio::time::sleep(ACCEPT_RETRY).await;
    }
}

async fn serve_connection(
    stream: TcpStream,
    peer: Peer,
    router: Router,
    write_timeout: Duration,
    [draining, closing]: [CancellationToken; 2],
) {
    let _ = stream.set_nodelay(true); // avoids delays of small answers; an error only keeps the delay
    let io = TokioIo::new(TimedStream::new(stream, write_timeout));
    let close = peer.connection.close.clone();
    let service = service_fn(move |mut request: hyper::Request<Incoming>| {
        let pending = peer.connection.begin_request();
        request.extensions_mut().insert(peer.clone());
        let (answer, draining) = (router.clone().oneshot(request), draining.clone());
        async move {
            let mut answer = answer.await?.map(|body| PendingBody { body, _pending: pending });
            if draining.is_cancelled() {
                answer.headers_mut().insert(header::CONNECTION, HeaderValue::from_static("close"));
            }
            Ok::<_, Infallible>(answer)
        }
    });
    let connection = http1::Builder::new().max_buf_size(64 << 10).serve_connection(io, service);
    let mut connection = std::pin::pin!(connection);
    let result = tokio::select! {
        result = connection.as_mut() => result,
        () = close.cancelled() => return,
        () = closing.cancelled() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = result {
        tracing::debug!(%error, "connection ended early");
    }
}

/// The body of an answer; its connection is busy until the body is dropped.
struct PendingBody {
    body: Body,
    _pending: Pending,
}

impl hyper::body::Body for PendingBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        Pin::new(&mut self.body).poll_frame(cx)
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
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
