//! `tombolo-load` through nginx, in the background.

use crate::process;
use anyhow::{Context, Result};
use serde_json::Value;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::{Child, Stdio};

/// A running load; it is stopped when it goes out of scope.
#[derive(Debug)]
pub struct Load {
    child: Child,
    json: PathBuf,
}

impl Load {
    /// Starts it on a stream.
    ///
    /// # Errors
    /// The program cannot be started.
    pub fn start(address: SocketAddr, clients: u32, seconds: u64, more: &[&str]) -> Result<Self> {
        let json = process::target().join("cluster").join(format!("load-{}.json", std::process::id()));
        // A report of an earlier run must not pass for one of this.
        let _ = std::fs::remove_file(&json);
        let child = process::command(process::program("tombolo-load"))
            .args(["--connect", &format!("ws://{address}/v1/stream")])
            .args(["--clients", &clients.to_string(), "--seconds", &seconds.to_string(), "--quiet"])
            .args(more)
            .arg("--json")
            .arg(&json)
            // It says that sessions were dropped, which is the point here.
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .context("cannot start tombolo-load")?;
        Ok(Self { child, json })
    }

    /// Waits for its end and reads its report.
    ///
    /// # Errors
    /// It left no report.
    pub fn report(mut self) -> Result<Value> {
        self.child.wait().context("tombolo-load")?;
        let text = std::fs::read(&self.json).with_context(|| format!("no report {}", self.json.display()))?;
        let _ = std::fs::remove_file(&self.json);
        serde_json::from_slice(&text).context("the report of tombolo-load")
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        // It has ended, unless a check failed before its end.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
