//! The baseline for cached chunks: nginx serving the same frames as static files to wrk. Both come
//! from the system's packages.

use crate::server_process::{ChildProcess, Launch};
use anyhow::{Context, Result, bail};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

/// nginx serving a folder of files; killed when dropped.
#[derive(Debug)]
pub struct Nginx {
    folder: PathBuf,
    port: u16,
    /// The only process: there are no separate workers.
    pub process: ChildProcess,
}

/// Result of a run of wrk.
#[derive(Clone, Copy, Debug)]
pub struct Rate {
    /// Replies a second.
    pub replies_per_s: f64,
    /// CPU seconds of nginx for each GB (10^9 bytes) of replies, headers included.
    pub cpu_s_per_gb: f64,
    /// CPU time of nginx over wall time. If it is low, wrk was the bottleneck.
    pub busy: f64,
}

/// Whether a program of this name can be run.
pub fn is_installed(program: &str) -> bool {
    let status = Command::new(program).arg("-v").stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok()
}

impl Nginx {
    /// Writes the files `0.bin`, `1.bin` ... and serves them.
    pub fn start(launch: &Launch, files: &[impl AsRef<[u8]>]) -> Result<Self> {
        let folder = std::env::temp_dir().join(format!("tombolo-nginx-{}", std::process::id()));
        let www = folder.join("www");
        std::fs::create_dir_all(&www).with_context(|| format!("cannot make {}", www.display()))?;
        for (index, file) in files.iter().enumerate() {
            std::fs::write(www.join(format!("{index}.bin")), file)?;
        }
        // Released again: nginx binds it a moment later.
        let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
        std::fs::write(folder.join("nginx.conf"), configuration(&folder, port))?;
        std::fs::write(folder.join("pipeline.lua"), PIPELINE)?;
        let child = launch
            .command(Path::new("nginx"))
            .arg("-p")
            .arg(&folder)
            .arg("-c")
            .arg(folder.join("nginx.conf"))
            .stderr(Stdio::null())
            .spawn()
            .context("cannot start nginx")?;
        let nginx = Self { folder, port, process: ChildProcess(child) };
        for _ in 0..200 {
            if std::net::TcpStream::connect(("127.0.0.1", port)).is_ok() {
                return Ok(nginx);
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        bail!("nginx does not answer on port {port}")
    }

    /// Requests all files in turn, with `window` requests outstanding on each connection.
    pub fn measure(&self, connections: usize, window: usize, n_files: usize, seconds: u64) -> Result<Rate> {
        let before = self.process.cpu_s()?;
        let output = Command::new("wrk")
            .args(["-t1", &format!("-c{connections}"), &format!("-d{seconds}s"), "-s"])
            .arg(self.folder.join("pipeline.lua"))
            .arg(format!("http://127.0.0.1:{}/", self.port))
            .args(["--", &window.to_string(), &n_files.to_string()])
            .output()
            .context("cannot run wrk")?;
        let cpu_s = self.process.cpu_s()? - before;
        let text = String::from_utf8_lossy(&output.stdout);
        let Some(line) = text.lines().find_map(|line| line.strip_prefix("MEASURED ")) else {
            bail!("no result in the output of wrk: {text}{}", String::from_utf8_lossy(&output.stderr));
        };
        let numbers: Vec<f64> = line.split_whitespace().filter_map(|number| number.parse().ok()).collect();
        let [replies, bytes, duration_us, errors] = numbers[..] else {
            bail!("expected four numbers from wrk, got `{line}`")
        };
        if errors > 0.0 {
            bail!("wrk counts {errors} failed requests");
        }
        let seconds = duration_us / 1e6;
        Ok(Rate {
            replies_per_s: replies / seconds,
            cpu_s_per_gb: cpu_s / (bytes / 1e9),
            busy: cpu_s / seconds,
        })
    }
}

impl Drop for Nginx {
    fn drop(&mut self) {
        // A temporary folder: a failed removal is harmless.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// The fastest configuration found for small files: one process, no log, all file descriptors kept
/// open, each reply in one write. With `sendfile` a reply takes two calls; with `tcp_nopush`
/// pipelined replies wait for acknowledgements, tens of milliseconds each.
fn configuration(folder: &Path, port: u16) -> String {
    let folder = folder.display();
    format!(
        "daemon off; master_process off; pid {folder}/nginx.pid; error_log {folder}/nginx.log;\n\
         events {{ worker_connections 4096; multi_accept on; }}\n\
         http {{ access_log off; sendfile off; tcp_nodelay on; keepalive_requests 1000000000;\n\
         open_file_cache max=4096 inactive=3600s; open_file_cache_valid 3600s;\n\
         client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy;\n\
         fastcgi_temp_path {folder}/fastcgi;\n\
         uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;\n\
         server {{ listen 127.0.0.1:{port} backlog=4096; root {folder}/www;\n\
         default_type application/octet-stream; }} }}\n"
    )
}

/// Makes wrk pipeline: it counts each request of a string with several, and keeps all of them
/// outstanding.
const PIPELINE: &str = r#"
local requests, at = {}, 0
function init(args)
  local window, files = tonumber(args[1]), tonumber(args[2])
  for first = 0, files - 1, window do
    local part = {}
    for index = 0, window - 1 do
      part[#part + 1] = wrk.format("GET", "/" .. ((first + index) % files) .. ".bin")
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
