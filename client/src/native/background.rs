//! One computation on a thread of its own, whose result is polled: what would take longer than a
//! frame.

use anyhow::Context as _;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};

/// A computation that runs on its own thread.
///
/// Dropping it does not wait: the thread ends when its computation does.
#[derive(Debug)]
pub struct Background<T> {
    name: &'static str,
    result: Receiver<T>,
}

impl<T: Send + 'static> Background<T> {
    /// Starts a computation. The thread bears the name, 15 bytes at most on Linux.
    ///
    /// # Errors
    /// The system has no thread left.
    pub fn start(name: &'static str, compute: impl FnOnce() -> T + Send + 'static) -> anyhow::Result<Self> {
        // Room for the one result, so that the thread never waits for the poll.
        let (sender, result): (SyncSender<T>, _) = sync_channel(1);
        std::thread::Builder::new()
            .name(name.into())
            // A dropped receiver means that the result is not wanted any more.
            .spawn(move || drop(sender.send(compute())))
            .with_context(|| format!("cannot start the thread {name}"))?;
        Ok(Self { name, result })
    }

    /// The result, once, when the computation has ended; never waits.
    ///
    /// # Errors
    /// The computation panicked, or its result was taken before.
    pub fn poll(&mut self) -> anyhow::Result<Option<T>> {
        match self.result.try_recv() {
            Ok(result) => Ok(Some(result)),
            Err(TryRecvError::Empty) => Ok(None),
            Err(TryRecvError::Disconnected) => anyhow::bail!("the thread {} has no result", self.name),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Polls until there is an answer.
    fn wait<T: Send + 'static>(background: &mut Background<T>) -> anyhow::Result<T> {
        loop {
            if let Some(result) = background.poll()? {
                return Ok(result);
            }
            std::thread::yield_now();
        }
    }

    #[test]
    fn a_poll_does_not_wait_and_the_result_comes_once_from_another_thread() {
        let (open, gate) = sync_channel::<()>(0);
        let mut background = Background::start("test", move || {
            gate.recv().unwrap();
            std::thread::current().id()
        })
        .unwrap();
        // The computation cannot end before the gate opens: a poll that waits would never return.
        assert!(background.poll().unwrap().is_none());
        open.send(()).unwrap();
        assert_ne!(wait(&mut background).unwrap(), std::thread::current().id());
        assert!(wait(&mut background).is_err(), "the result was taken");
    }

    #[test]
    fn a_computation_that_panics_is_an_error_with_its_name() {
        let mut background: Background<()> = Background::start("test", || panic!("on purpose")).unwrap();
        let error = wait(&mut background).unwrap_err().to_string();
        assert_eq!(error, "the thread test has no result");
    }

    #[test]
    fn an_unwanted_computation_ends_by_itself() {
        let (open, gate) = sync_channel::<()>(0);
        let (sender, ended) = sync_channel(1);
        let background = Background::start("test", move || {
            gate.recv().unwrap();
            sender.send(()).unwrap();
        })
        .unwrap();
        drop(background);
        open.send(()).unwrap();
        assert!(ended.recv().is_ok());
    }
}
