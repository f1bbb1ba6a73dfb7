//! nginx with the configuration of `deploy/nginx`: that file itself, and for this machine the files
//! that it includes.

use crate::process;
use anyhow::{Context, Result, bail};
use std::fmt::Write as _;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// The configuration that the compose file mounts.
const CONFIGURATION: &str = include_str!("../../../deploy/nginx/nginx.conf");

/// Time until nginx must accept connections.
const READY_WITHIN: Duration = Duration::from_secs(5);

/// Time for its end.
const END_WITHIN: Duration = Duration::from_secs(5);

/// A running nginx with a folder of its own; both end with it.
#[derive(Debug)]
pub struct Nginx {
    child: Child,
    address: SocketAddr,
    folder: PathBuf,
}

impl Nginx {
    /// Starts nginx before replicas at these addresses, on a free port of the loopback.
    ///
    /// # Errors
    /// nginx is not installed, rejects the configuration, or does not listen in time.
    pub fn start(replicas: &[SocketAddr]) -> Result<Self> {
        let folder = process::target().join("cluster").join(std::process::id().to_string());
        std::fs::create_dir_all(folder.join("temporary"))
            .with_context(|| format!("cannot create {}", folder.display()))?;
        // Released again: nginx binds it a moment later.
        let address = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
        for (name, text) in [
            ("nginx.conf", CONFIGURATION.to_owned()),
            ("listen.conf", format!("listen {address} backlog=4096;\n")),
            ("replicas.conf", replicas_of(replicas, &folder)),
        ] {
            std::fs::write(folder.join(name), text).with_context(|| format!("cannot write {name}"))?;
        }
        let child = process::command("nginx")
            .arg("-p")
            .arg(&folder)
            .arg("-c")
            .arg(folder.join("nginx.conf"))
            .args(["-g", &format!("daemon off; pid {}/pid;", folder.display())])
            .stdin(Stdio::null())
            // The log of requests.
            .stdout(Stdio::null())
            .spawn()
            .context("cannot start nginx; on Debian and Ubuntu: apt-get install nginx")?;
        let mut nginx = Self { child, address, folder };
        let deadline = Instant::now() + READY_WITHIN;
        while TcpStream::connect(address).is_err() {
            if !nginx.is_running() || Instant::now() > deadline {
                bail!("nginx does not listen at {address}; its message is above");
            }
            sleep(Duration::from_millis(10));
        }
        Ok(nginx)
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Whether it still runs.
    pub fn is_running(&mut self) -> bool {
        matches!(self.child.try_wait(), Ok(None))
    }
}

impl Drop for Nginx {
    fn drop(&mut self) {
        process::stop(&mut self.child, END_WITHIN);
        // Results of a build may stay: a failed removal is harmless.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

/// The file of the upstreams, with the folders that a container has elsewhere.
fn replicas_of(replicas: &[SocketAddr], folder: &Path) -> String {
    let mut text = String::new();
    for (name, rule, more) in
        [("sessions", "least_conn;", ""), ("chunks", "hash $uri consistent;", "keepalive 32;")]
    {
        writeln!(text, "upstream {name} {{ {rule}").expect("a string");
        for address in replicas {
            writeln!(text, "    server {address} max_fails=1 fail_timeout=2s;").expect("a string");
        }
        writeln!(text, "{more} }}").expect("a string");
    }
    let folder = folder.display();
    writeln!(
        text,
        "proxy_cache_path {folder}/cache levels=1:2 keys_zone=chunks:32m max_size=1g inactive=1h \
         use_temp_path=off;"
    )
    .expect("a string");
    for kind in ["client_body", "proxy", "fastcgi", "uwsgi", "scgi"] {
        writeln!(text, "{kind}_temp_path {folder}/temporary/{kind};").expect("a string");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_replicas_of_a_desk_have_the_upstreams_and_the_cache_of_the_container() {
        let container = include_str!("../../../deploy/nginx/replicas.conf");
        let desk = replicas_of(&["127.0.0.1:7001".parse().unwrap()], Path::new("/tmp/x"));
        for part in [
            "upstream sessions",
            "least_conn;",
            "upstream chunks",
            "hash $uri consistent;",
            "max_fails=1 fail_timeout=2s;",
            "keepalive 32;",
            "keys_zone=chunks:32m",
        ] {
            assert!(container.contains(part) && desk.contains(part), "{part}");
        }
        // What the configuration asks of both.
        for part in ["http://sessions", "http://chunks", "proxy_cache chunks;", "include replicas.conf;"] {
            assert!(CONFIGURATION.contains(part), "{part}");
        }
    }
}
