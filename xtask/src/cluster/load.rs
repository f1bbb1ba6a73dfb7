//! `tombolo-load` through nginx, in the background.

use crate::process;
use anyhow::{Context, Result, anyhow};
use serde_json::Value;
use std::fs::File;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};

/// A running load; it is stopped when it goes out of scope.
#[derive(Debug)]
pub struct Load {
    child: Child,
    json: PathBuf,
    /// Its standard error.
    log: PathBuf,
}

impl Load {
    /// Starts it on a stream.
    ///
    /// # Errors
    /// The program cannot be started, or its files cannot be created.
    pub fn start(address: SocketAddr, clients: u32, seconds: u64, more: &[&str]) -> Result<Self> {
        let folder = process::target().join("cluster");
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot create {}", folder.display()))?;
        let json = folder.join(format!("load-{}.json", std::process::id()));
        let log = json.with_extension("log");
        let said = File::create(&log).with_context(|| format!("cannot write {}", log.display()))?;
        // A report of an earlier run must not pass for one of this.
        let _ = std::fs::remove_file(&json);
        let child = process::command(process::program("tombolo-load"))
            .args(["--connect", &format!("ws://{address}/v1/stream")])
            .args(["--clients", &clients.to_string(), "--seconds", &seconds.to_string(), "--quiet"])
            .args(more)
            .arg("--json")
            .arg(&json)
            .stdout(Stdio::null())
            // Not shown: it says that sessions were dropped, which is the point here.
            .stderr(said)
            .spawn()
            .context("cannot start tombolo-load")?;
        Ok(Self { child, json, log })
    }

    /// Waits for its end and reads its report.
    ///
    /// # Errors
    /// It left no report; its log stays then.
    pub fn report(mut self) -> Result<Value> {
        let ended = self.child.wait().context("tombolo-load")?;
        let report = read(&self.json, &self.log).with_context(|| format!("tombolo-load ended ({ended})"))?;
        for file in [&self.json, &self.log] {
            // Results of a build may stay: a failed removal is harmless.
            let _ = std::fs::remove_file(file);
        }
        Ok(report)
    }
}

impl Drop for Load {
    fn drop(&mut self) {
        // It has ended, unless a check failed before its end.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The report. The program creates its file at the start, so that a file without content is none.
fn read(json: &Path, log: &Path) -> Result<Value> {
    let text = std::fs::read(json).map_err(|error| error.to_string());
    let parsed = text.and_then(|text| serde_json::from_slice(&text).map_err(|error| error.to_string()));
    parsed.map_err(|error| {
        let said = std::fs::read(log).unwrap_or_default();
        let said = String::from_utf8_lossy(&said);
        let last = said.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("it said nothing").trim();
        anyhow!("no report {} ({error}): {last}", json.display())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_report_the_error_has_the_last_line_of_the_log() {
        let folder = std::env::temp_dir().join(format!("tombolo-load-report-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let (json, log) = (folder.join("load.json"), folder.join("load.log"));
        let error = || read(&json, &log).unwrap_err().to_string();
        assert!(error().starts_with("no report") && error().ends_with("it said nothing"), "{}", error());
        std::fs::write(&log, "first\nlast\n\n").unwrap();
        assert!(error().ends_with(": last"), "{}", error());
        std::fs::write(&json, "").unwrap();
        assert!(error().starts_with("no report") && error().ends_with(": last"), "{}", error());
        std::fs::write(&json, "{\"chunks\": 1}").unwrap();
        assert_eq!(read(&json, &log).unwrap()["chunks"], 1);
        std::fs::remove_dir_all(folder).unwrap();
    }
}
