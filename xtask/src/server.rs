//! A running `tombolo-server` that is stopped when it goes out of scope, whatever happened
//! meanwhile.

use crate::process;
use anyhow::{Context, Result, bail};
use std::net::{SocketAddr, TcpListener};
use std::path::Path;
use std::process::{Child, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Time until `/readyz` must say yes.
const READY_WITHIN: Duration = Duration::from_secs(20);

/// Time for one answer of `/readyz`.
const ANSWER_WITHIN: Duration = Duration::from_secs(2);

/// Time for a graceful end; the server's own drain takes at most 5 s.
const DRAIN_WITHIN: Duration = Duration::from_secs(12);

/// See the module.
#[derive(Debug)]
pub struct Server {
    child: Child,
    address: SocketAddr,
}

impl Server {
    /// Starts the release build on a free port of the loopback and waits until it is ready.
    ///
    /// # Errors
    /// No port, no program, or a server that ends or is not ready in time.
    pub fn start(world_seed: u64) -> Result<Self> {
        Self::start_with(world_seed, &[])
    }

    /// As [`Server::start`], with settings in its environment.
    ///
    /// # Errors
    /// As [`Server::start`].
    pub fn start_with(world_seed: u64, settings: &[(&str, String)]) -> Result<Self> {
        Self::start_program(&process::program("tombolo-server"), world_seed, settings)
    }

    /// As [`Server::start_with`], of another build.
    ///
    /// # Errors
    /// As [`Server::start`].
    pub fn start_program(program: &Path, world_seed: u64, settings: &[(&str, String)]) -> Result<Self> {
        Self::started(program, free_address()?, world_seed, settings)
    }

    /// As [`Server::start_with`], at an address.
    ///
    /// # Errors
    /// As [`Server::start`].
    pub fn start_at(address: SocketAddr, world_seed: u64, settings: &[(&str, String)]) -> Result<Self> {
        Self::started(&process::program("tombolo-server"), address, world_seed, settings)
    }

    fn started(
        program: &Path,
        address: SocketAddr,
        world_seed: u64,
        settings: &[(&str, String)],
    ) -> Result<Self> {
        let child = process::command(program)
            // A load has one address for all of its clients.
            .env("TOMBOLO_MAX_SESSIONS_PER_ADDRESS", "1024")
            .envs(settings.iter().map(|(name, value)| (name, value)))
            .args(["--listen", &address.to_string(), "--world-seed", &world_seed.to_string()])
            // Its own lines would drown ours; faults are still shown.
            .env("TOMBOLO_LOG", "warn")
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .context("cannot start tombolo-server; run `cargo build --release --bin tombolo-server`")?;
        let mut server = Self { child, address };
        server.wait_until_ready()?;
        Ok(server)
    }

    /// The address of its WebSocket stream.
    pub fn stream(&self) -> String {
        format!("ws://{}/v1/stream", self.address)
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Ends it at once, as a power cut would.
    pub fn kill(&mut self) {
        // It may have ended before.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Asks it to end, as an operator would; the time until its process has ended, none if it had
    /// to be killed or failed.
    pub fn terminate(&mut self) -> Option<Duration> {
        let started = Instant::now();
        process::stop(&mut self.child, DRAIN_WITHIN);
        let took = started.elapsed();
        let has_succeeded = self.child.wait().is_ok_and(|status| status.success());
        (has_succeeded && took < DRAIN_WITHIN).then_some(took)
    }

    /// Process id, for `/proc`.
    pub fn pid(&self) -> u32 {
        self.child.id()
    }

    /// Whether it still runs; a server that died cannot have passed anything.
    pub fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }

    fn wait_until_ready(&mut self) -> Result<()> {
        let url = format!("http://{}/readyz", self.address);
        let deadline = Instant::now() + READY_WITHIN;
        let timeout = Some(ANSWER_WITHIN);
        let agent: ureq::Agent =
            ureq::Agent::config_builder().timeout_global(timeout).proxy(None).build().into();
        while Instant::now() < deadline {
            if let Some(status) = self.child.try_wait().context("cannot wait for tombolo-server")? {
                bail!("tombolo-server ended before it was ready ({status}); its message is above");
            }
            if process::interrupted() {
                bail!("interrupted");
            }
            // An HTTP status other than 2xx is an error here, as a refused connection is.
            if agent.get(&url).call().is_ok() {
                return Ok(());
            }
            sleep(Duration::from_millis(20));
        }
        bail!("tombolo-server was not ready within {READY_WITHIN:?}: {url} never answered 200");
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        process::stop(&mut self.child, DRAIN_WITHIN);
    }
}

/// A port that is free now. Another process may take it before the program that is given it.
///
/// # Errors
/// No port is free.
pub fn free_address() -> Result<SocketAddr> {
    let listener = TcpListener::bind("127.0.0.1:0").context("no free port on 127.0.0.1")?;
    listener.local_addr().context("no free port on 127.0.0.1")
}
