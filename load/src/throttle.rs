//! A stream with a limited read rate.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep, sleep_until};

/// Bytes read at once; a pause after each read gives the rate.
const READ_SIZE: usize = 512;

/// A stream with an optional limit of its read rate. Writes are not limited.
#[derive(Debug)]
pub struct Throttled<S> {
    stream: S,
    /// Time per byte, and the pause after the last read.
    slow: Option<(Duration, Pin<Box<Sleep>>)>,
}

impl<S> Throttled<S> {
    /// Limits reads to `bytes_per_s`, at least 1; none is no limit.
    #[must_use]
    pub fn new(stream: S, bytes_per_s: Option<u32>) -> Self {
        let slow = bytes_per_s
            .map(|rate| (Duration::from_secs(1) / rate.max(1), Box::pin(sleep_until(Instant::now()))));
        Self { stream, slow }
    }

    /// The inner stream.
    pub fn into_inner(self) -> S {
        self.stream
    }
}

impl<S: AsyncRead + Unpin> AsyncRead for Throttled<S> {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let this = &mut *self;
        let Some((per_byte, pause)) = &mut this.slow else {
            return Pin::new(&mut this.stream).poll_read(cx, buffer);
        };
        ready!(pause.as_mut().poll(cx));
        let mut part = [0; READ_SIZE];
        let mut part = ReadBuf::new(&mut part[..READ_SIZE.min(buffer.remaining())]);
        ready!(Pin::new(&mut this.stream).poll_read(cx, &mut part))?;
        buffer.put_slice(part.filled());
        let taken = u32::try_from(part.filled().len()).unwrap_or(u32::MAX);
        pause.as_mut().reset(Instant::now() + *per_byte * taken);
        Poll::Ready(Ok(()))
    }
}

impl<S: AsyncWrite + Unpin> AsyncWrite for Throttled<S> {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, bytes: &[u8]) -> Poll<io::Result<usize>> {
        Pin::new(&mut self.stream).poll_write(cx, bytes)
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use tokio::io::{AsyncReadExt, AsyncWriteExt, duplex};

    async fn seconds_for(bytes: usize, rate: Option<u32>) -> f64 {
        let (mut writer, reader) = duplex(1 << 20);
        writer.write_all(&vec![7; bytes]).await.unwrap();
        drop(writer);
        let started = Instant::now();
        let mut all = Vec::new();
        Throttled::new(reader, rate).read_to_end(&mut all).await.unwrap();
        assert_eq!(all, vec![7; bytes], "no byte is lost or changed");
        started.elapsed().as_secs_f64()
    }

    #[tokio::test(start_paused = true)]
    async fn the_rate_limits_reads_and_no_rate_does_not() {
        let slow = seconds_for(20_000, Some(2000)).await;
        assert!((9.9..10.3).contains(&slow), "{slow}");
        assert!(seconds_for(20_000, None).await < 1e-3, "control");
    }
}
