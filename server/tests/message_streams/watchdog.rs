//! A server on one thread, with a task that takes a turn whenever it can and measures the processor
//! time between two of them: as long waits the task that accepts connections.

use rustix::time::{ClockId, clock_gettime};
use server::ServerConfig;
use std::net::SocketAddr;
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::oneshot;

/// A running server.
pub struct Watched {
    pub address: SocketAddr,
    stop: oneshot::Sender<()>,
    thread: JoinHandle<Duration>,
}

impl Watched {
    /// Stops the server; returns its longest turn.
    pub fn stop(self) -> Duration {
        drop(self.stop);
        self.thread.join().expect("the server ends without a panic")
    }
}

/// Starts a server on a thread and a port of its own.
pub fn start(config: ServerConfig) -> Watched {
    let (stop, stopped) = oneshot::channel::<()>();
    let (announce, announced) = std::sync::mpsc::channel();
    let thread = std::thread::spawn(move || {
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build().unwrap();
        runtime.block_on(async {
            let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
            announce.send(listener.local_addr().unwrap()).unwrap();
            let stopped = async {
                let _ = stopped.await;
            };
            let served = tokio::spawn(server::run(listener, config, stopped));
            watch(served).await
        })
    });
    Watched { address: announced.recv().unwrap(), stop, thread }
}

/// Takes turns until the server has ended; returns the longest time between two of them.
async fn watch<T>(served: tokio::task::JoinHandle<T>) -> Duration {
    // The first turns start the server.
    tokio::time::sleep(Duration::from_millis(50)).await;
    let (mut longest, mut last) = (Duration::ZERO, thread_time());
    while !served.is_finished() {
        tokio::task::yield_now().await;
        let now = thread_time();
        longest = longest.max(now.saturating_sub(last));
        last = now;
    }
    served.await.expect("the server ends without a panic");
    longest
}

/// Processor time of this thread.
fn thread_time() -> Duration {
    let time = clock_gettime(ClockId::ThreadCPUTime);
    Duration::new(time.tv_sec.unsigned_abs(), time.tv_nsec.unsigned_abs() as u32)
}
