//! The baseline for cached chunks: nginx serving the same frames as static files. It comes from the
//! system's packages.

use crate::server_process::{ChildProcess, Launch};
use anyhow::{Context, Result, bail};
use std::net::{SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::Duration;

/// nginx serving a folder of files; killed when dropped.
#[derive(Debug)]
pub struct Nginx {
    folder: PathBuf,
    /// Where it listens.
    pub address: SocketAddr,
    /// The only process: there are no separate workers.
    pub process: ChildProcess,
}

/// Whether a program of this name can be run.
pub fn is_installed(program: &str) -> bool {
    let status = Command::new(program).arg("-v").stdout(Stdio::null()).stderr(Stdio::null()).status();
    status.is_ok()
}

impl Nginx {
    /// Writes the files of [`Nginx::paths`] and serves them.
    pub fn start(launch: &Launch, files: &[impl AsRef<[u8]>]) -> Result<Self> {
        let folder = std::env::temp_dir().join(format!("tombolo-nginx-{}", std::process::id()));
        let www = folder.join("www");
        std::fs::create_dir_all(&www).with_context(|| format!("cannot make {}", www.display()))?;
        for (file, path) in files.iter().zip(Self::paths(files.len())) {
            std::fs::write(www.join(&path[1..]), file)?;
        }
        // Released again: nginx binds it a moment later.
        let address = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
        std::fs::write(folder.join("nginx.conf"), configuration(&folder, address))?;
        let child = launch
            .command(Path::new("nginx"))
            .arg("-p")
            .arg(&folder)
            .arg("-c")
            .arg(folder.join("nginx.conf"))
            .stderr(Stdio::null())
            .spawn()
            .context("cannot start nginx")?;
        let nginx = Self { folder, address, process: ChildProcess(child) };
        for _ in 0..200 {
            if std::net::TcpStream::connect(address).is_ok() {
                return Ok(nginx);
            }
            std::thread::sleep(Duration::from_millis(10));
        }
        bail!("nginx does not answer at {address}")
    }

    /// The paths of `n_files` files.
    pub fn paths(n_files: usize) -> Vec<String> {
        (0..n_files).map(|index| format!("/{index}.bin")).collect()
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
fn configuration(folder: &Path, address: SocketAddr) -> String {
    let folder = folder.display();
    format!(
        "daemon off; master_process off; pid {folder}/nginx.pid; error_log {folder}/nginx.log;\n\
         events {{ worker_connections 4096; multi_accept on; }}\n\
         http {{ access_log off; sendfile off; tcp_nodelay on; keepalive_requests 1000000000;\n\
         open_file_cache max=4096 inactive=3600s; open_file_cache_valid 3600s;\n\
         client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy;\n\
         fastcgi_temp_path {folder}/fastcgi;\n\
         uwsgi_temp_path {folder}/uwsgi; scgi_temp_path {folder}/scgi;\n\
         server {{ listen {address} backlog=4096; root {folder}/www;\n\
         default_type application/octet-stream; }} }}\n"
    )
}
