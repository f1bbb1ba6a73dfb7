//! What static files are served at: nginx with the same chunks as files, driven by wrk, both from
//! the system's packages.

use super::host::{Launch, Watched};
use anyhow::{Context, Result, bail};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

/// nginx over a folder of files, ended when dropped.
#[derive(Debug)]
pub struct Rival {
    folder: PathBuf,
    port: u16,
    /// The only process: it is its own worker.
    pub process: Watched,
}

/// What wrk counted.
#[derive(Clone, Copy, Debug)]
pub struct Rate {
    /// Replies a second.
    pub replies_per_s: f64,
    /// Server's processor seconds for each GB (10^9 bytes) of replies, headers included.
    pub cpu_s_per_gb: f64,
    /// Share of the time in which the server was busy: a rival that waits is not measured.
    pub busy: f64,
}

/// Whether a program of this name can be run.
#[must_use]
pub fn is_installed(program: &str) -> bool {
    let status = Command::new(program).arg("-v").stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok()
}

impl Rival {
    /// Writes the files `0.bin`, `1.bin` ... and serves them.
    ///
    /// # Errors
    /// The folder cannot be written or nginx does not start.
    pub fn start(launch: &Launch, files: &[impl AsRef<[u8]>]) -> Result<Self> {
        let folder = std::env::temp_dir().join(format!("tombolo-rival-{}", std::process::id()));
        let www = folder.join("www");
        std::fs::create_dir_all(&www).with_context(|| format!("cannot make {}", www.display()))?;
        for (index, file) in files.iter().enumerate() {
            std::fs::write(www.join(format!("{index}.bin")), file)?;
        }
        // Asked for and given back; the port is free when nginx asks a moment later.
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
        let rival = Self { folder, port, process: Watched::new(child) };
        for _ in 0..200 {
            if std::net::TcpStream::connect(("127.0.0.1", port)).is_ok() {
                return Ok(rival);
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        bail!("nginx does not answer on port {port}")
    }

    /// Asks for all files in turn over so many connections with so many requests outstanding each.
    ///
    /// # Errors
    /// wrk fails or says something else than expected.
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
            bail!("wrk does not say what it measured: {text}{}", String::from_utf8_lossy(&output.stderr));
        };
        let numbers: Vec<f64> = line.split_whitespace().filter_map(|number| number.parse().ok()).collect();
        let [replies, bytes, duration_us, errors] = numbers[..] else { bail!("wrk says `{line}`") };
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

impl Drop for Rival {
    fn drop(&mut self) {
        // In the system's folder for such things; what cannot be removed does no harm.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// One process, no log, descriptors of all files kept open, whole replies in one write: the fastest
/// way for small files that was found. With `sendfile` a reply takes two calls, and with
/// `tcp_nopush` pipelined replies wait for acknowledgements, tens of milliseconds each.
fn configuration(folder: &Path, port: u16) -> String {
    let folder = folder.display();
    format!(
        "daemon off; master_process off; pid {folder}/nginx.pid; error_log {folder}/nginx.log;\n\
         events {{ worker_connections 4096; multi_accept on; }}\n\
         http {{ access_log off; sendfile off; tcp_nodelay on; keepalive_requests 1000000000;\n\
         open_file_cache max=4096 inactive=3600s; open_file_cache_valid 3600s;\n\
         client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy; fastcgi_temp_path {folder}/fastcgi;\n\
         uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;\n\
         server {{ listen 127.0.0.1:{port} backlog=4096; root {folder}/www; default_type application/octet-stream; }} }}\n"
    )
}

/// wrk counts one reply for each request in a string of several, and keeps as many outstanding as
/// the string holds.
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
