//! wrk, an HTTP client from the system's packages: one thread, a closed loop over keep-alive
//! connections. A connection sends its next requests when all answers to its last ones are
//! complete.

use crate::server_process::ChildProcess;
use anyhow::{Context, Result, bail};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::process::Command;

/// The requests of a run, in a folder of their own that is removed when dropped.
#[derive(Debug)]
pub struct Wrk {
    folder: PathBuf,
}

/// How a run of wrk requests.
#[derive(Clone, Copy, Debug)]
pub struct Load {
    /// Keep-alive connections.
    pub connections: usize,
    /// Requests sent together on a connection; 1 is one in flight, without pipelining.
    pub in_flight: usize,
    /// Length of the run.
    pub seconds: u64,
}

/// Result of a run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rate {
    /// Replies a second.
    pub replies_per_s: f64,
    /// Bytes of a reply, headers included.
    pub reply_bytes: f64,
    /// CPU seconds of the server for each GB (10^9 bytes) of replies, headers included.
    pub cpu_s_per_gb: f64,
    /// CPU time of the server over wall time. If it is low, wrk was the bottleneck.
    pub busy: f64,
}

impl Wrk {
    /// Requests of these paths in turn. `name` is different for each set of requests of a process.
    pub fn new(name: &str, paths: &[String]) -> Result<Self> {
        let folder = std::env::temp_dir().join(format!("tombolo-wrk-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&folder).with_context(|| format!("cannot make {}", folder.display()))?;
        std::fs::write(folder.join("requests.lua"), REQUESTS)?;
        std::fs::write(folder.join("paths"), paths.join("\n"))?;
        Ok(Self { folder })
    }

    /// Loads the server at an address, whose process is given.
    pub fn measure(&self, address: SocketAddr, process: &ChildProcess, load: Load) -> Result<Rate> {
        let before = process.cpu_s()?;
        let output = Command::new("wrk")
            .args(["-t1", &format!("-c{}", load.connections), &format!("-d{}s", load.seconds), "-s"])
            .arg(self.folder.join("requests.lua"))
            .arg(format!("http://{address}/"))
            .args(["--", &load.in_flight.to_string()])
            .arg(self.folder.join("paths"))
            .output()
            .context("cannot run wrk")?;
        let cpu_s = process.cpu_s()? - before;
        let text = String::from_utf8_lossy(&output.stdout);
        rate(&text, cpu_s).with_context(|| {
            format!("no result in the output of wrk: {text}{}", String::from_utf8_lossy(&output.stderr))
        })
    }
}

impl Drop for Wrk {
    fn drop(&mut self) {
        // A temporary folder: a failed removal is harmless.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// The result in the output of a run, in which the server used `cpu_s` CPU seconds.
fn rate(output: &str, cpu_s: f64) -> Result<Rate> {
    let line =
        output.lines().find_map(|line| line.strip_prefix("MEASURED ")).context("no line of the script")?;
    let numbers: Vec<f64> = line.split_whitespace().filter_map(|number| number.parse().ok()).collect();
    let [replies, bytes, duration_us, errors] = numbers[..] else {
        bail!("expected four numbers from wrk, got `{line}`")
    };
    if errors > 0.0 || replies == 0.0 {
        bail!("wrk counts {errors} failed requests and {replies} replies");
    }
    let seconds = duration_us / 1e6;
    Ok(Rate {
        replies_per_s: replies / seconds,
        reply_bytes: bytes / replies,
        cpu_s_per_gb: cpu_s / (bytes / 1e9),
        busy: cpu_s / seconds,
    })
}

/// wrk counts each request of a string with several, and sends the next string when all of them are
/// answered.
const REQUESTS: &str = r#"
local requests, at = {}, 0
function init(args)
  local window, paths = tonumber(args[1]), {}
  for path in io.lines(args[2]) do paths[#paths + 1] = path end
  for first = 0, #paths - 1, window do
    local part = {}
    for index = 0, window - 1 do
      part[#part + 1] = wrk.format("GET", paths[(first + index) % #paths + 1])
    end
    requests[#requests + 1] = table.concat(part)
  end
end
function request()
  at = at % #requests + 1
  return requests[at]
end
function done(summary, latency, all)
  local e = summary.errors
  print(string.format("MEASURED %d %d %d %d", summary.requests, summary.bytes, summary.duration,
    e.connect + e.read + e.write + e.status + e.timeout))
end
"#;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_is_read_from_the_output_and_a_failed_request_is_an_error() {
        let expected = Rate { replies_per_s: 500.0, reply_bytes: 2e3, cpu_s_per_gb: 500.0, busy: 0.5 };
        assert_eq!(rate("x\nMEASURED 1000 2000000 2000000 0\n", 1.0).unwrap(), expected);
        for output in ["MEASURED 1000 2000000 2000000 1", "MEASURED 0 0 2000000 0", "MEASURED 1 2", ""] {
            assert!(rate(output, 1.0).is_err(), "{output}");
        }
    }
}
