//! A stream whose writes time out: a write without progress for too long fails.
//!
//! hyper has no write timeout, and a blocked connection keeps its connection permit. Sessions have
//! their own deadline per flush; this one covers the HTTP part of a connection.

use std::io::{self, ErrorKind, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Sleep, sleep};

/// See the module.
#[derive(Debug)]
pub struct WriteTimeoutStream<S> {
    stream: S,
    timeout: Duration,
    /// Runs while a write is pending. Boxed, since most connections never need it.
    timer: Option<Pin<Box<Sleep>>>,
}

impl<S> WriteTimeoutStream<S> {
    /// Wraps a stream.
    pub const fn new(stream: S, timeout: Duration) -> Self {
        Self { stream, timeout, timer: None }
    }

    /// The wrapped stream.
    pub fn into_inner(self) -> S {
        self.stream
    }

    /// The result of a write; [`ErrorKind::TimedOut`] if it has been pending for too long.
    fn check<T>(&mut self, context: &mut Context<'_>, wrote: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if wrote.is_ready() {
            self.timer = None;
            return wrote;
        }
        let timer = self.timer.get_or_insert_with(|| Box::pin(sleep(self.timeout)));
        timer.as_mut().poll(context).map(|()| Err(ErrorKind::TimedOut.into()))
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for WriteTimeoutStream<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        into: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(context, into)
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for WriteTimeoutStream<S> {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let wrote = Pin::new(&mut self.stream).poll_write(context, bytes);
        self.check(context, wrote)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        slices: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let wrote = Pin::new(&mut self.stream).poll_write_vectored(context, slices);
        self.check(context, wrote)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let flushed = Pin::new(&mut self.stream).poll_flush(context);
        self.check(context, flushed)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        let shut = Pin::new(&mut self.stream).poll_shutdown(context);
        self.check(context, shut)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    use tokio::time::Instant;

    const TIMEOUT: Duration = Duration::from_secs(10);

    #[tokio::test(start_paused = true)]
    async fn a_write_to_a_peer_that_does_not_read_times_out() {
        let (near, _far) = tokio::io::duplex(100);
        let (mut near, start) = (WriteTimeoutStream::new(near, TIMEOUT), Instant::now());
        let error = near.write_all(&[0; 1000]).await.unwrap_err();
        assert_eq!(error.kind(), ErrorKind::TimedOut);
        assert_eq!(start.elapsed().as_secs(), TIMEOUT.as_secs());
    }

    #[tokio::test(start_paused = true)]
    async fn a_slow_reader_does_not_time_out_while_it_reads() {
        let (near, mut far) = tokio::io::duplex(100);
        let mut near = WriteTimeoutStream::new(near, TIMEOUT);
        let reading = async {
            let mut total = 0;
            while total < 1000 {
                sleep(TIMEOUT * 9 / 10).await;
                total += far.read(&mut [0; 100]).await.unwrap();
            }
        };
        let (wrote, ()) = tokio::join!(near.write_all(&[0; 1000]), reading);
        wrote.unwrap();
    }

    /// A stream that takes everything, and counts what is asked of it.
    #[derive(Debug, Default)]
    struct Asked {
        is_vectored: bool,
        flushes: u32,
        ends: u32,
    }

    impl AsyncWrite for Asked {
        fn poll_write(self: Pin<&mut Self>, _: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
            Poll::Ready(Ok(bytes.len()))
        }

        fn is_write_vectored(&self) -> bool {
            self.is_vectored
        }

        fn poll_flush(mut self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            self.flushes += 1;
            Poll::Ready(Ok(()))
        }

        fn poll_shutdown(mut self: Pin<&mut Self>, _: &mut Context<'_>) -> Poll<io::Result<()>> {
            self.ends += 1;
            Poll::Ready(Ok(()))
        }
    }

    #[tokio::test]
    async fn all_but_the_timeout_is_that_of_the_wrapped_stream() {
        for is_vectored in [false, true] {
            let mut near = WriteTimeoutStream::new(Asked { is_vectored, ..Asked::default() }, TIMEOUT);
            assert_eq!(near.is_write_vectored(), is_vectored);
            assert_eq!(near.write_vectored(&[IoSlice::new(b"both"), IoSlice::new(b"")]).await.unwrap(), 4);
            near.flush().await.unwrap();
            near.shutdown().await.unwrap();
            let Asked { flushes, ends, .. } = near.into_inner();
            assert_eq!((flushes, ends), (1, 1));
        }
    }
}
