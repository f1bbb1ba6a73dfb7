//! A reader that takes its time: at most so many bytes a second come through.

use std::io;
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep, sleep_until};

/// Bytes taken at once; a pause follows each that gives the rate.
const SIP: usize = 512;

/// A stream of which reading is slow, or as it is where no rate is given. Writing is as it is.
#[derive(Debug)]
pub struct Throttled<S> {
    stream: S,
    /// Time that a byte takes, and the pause that the last bytes ask for.
    slow: Option<(Duration, Pin<Box<Sleep>>)>,
}

impl<S> Throttled<S> {
    /// Lets `bytes_per_s`, at least 1, through; none lets through what comes.
    #[must_use]
    pub fn new(stream: S, bytes_per_s: Option<u32>) -> Self {
        let slow = bytes_per_s
            .map(|rate| (Duration::from_secs(1) / rate.max(1), Box::pin(sleep_until(Instant::now()))));
        Self { stream, slow }
    }

    /// The stream itself.
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
        let mut sip = [0; SIP];
        let mut sip = ReadBuf::new(&mut sip[..SIP.min(buffer.remaining())]);
        ready!(Pin::new(&mut this.stream).poll_read(cx, &mut sip))?;
        buffer.put_slice(sip.filled());
        let taken = u32::try_from(sip.filled().len()).unwrap_or(u32::MAX);
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
        assert_eq!(all, vec![7; bytes], "nothing is lost or changed");
        started.elapsed().as_secs_f64()
    }

    #[tokio::test(start_paused = true)]
    async fn bytes_come_at_the_rate_and_without_one_at_once() {
        let slow = seconds_for(20_000, Some(2000)).await;
        assert!((9.9..10.3).contains(&slow), "{slow}");
        assert!(seconds_for(20_000, None).await < 1e-3, "the control");
    }
}
