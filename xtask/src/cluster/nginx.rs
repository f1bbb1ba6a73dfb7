//! nginx with the configuration of `deploy/nginx`: that file itself, and for this machine the files
//! that it includes.

use crate::process;
use anyhow::{Context, Result, bail, ensure};
use std::fmt::Write as _;
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
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
    metrics: SocketAddr,
    folder: PathBuf,
}

impl Nginx {
    /// Starts nginx before replicas at these addresses, on a free port of the loopback, with an
    /// empty cache.
    ///
    /// # Errors
    /// nginx is not installed, rejects the configuration, or does not listen in time.
    pub fn start(replicas: &[SocketAddr]) -> Result<Self> {
        let folder = super::folder("nginx")?;
        std::fs::create_dir_all(folder.join("temporary"))
            .with_context(|| format!("cannot create {}", folder.display()))?;
        // Released again: nginx binds them a moment later.
        let ports = [TcpListener::bind("127.0.0.1:0")?, TcpListener::bind("127.0.0.1:0")?];
        let [address, metrics] = [ports[0].local_addr()?, ports[1].local_addr()?];
        drop(ports);
        let child = spawn(&folder, [address, metrics], replicas)?;
        Ok(Self { child, address, metrics, folder })
    }

    /// Ends it and starts it again before other replicas, with the cache that it has.
    ///
    /// # Errors
    /// As [`Nginx::start`].
    pub fn restart(&mut self, replicas: &[SocketAddr]) -> Result<()> {
        process::stop(&mut self.child, END_WITHIN);
        self.child = spawn(&self.folder, [self.address, self.metrics], replicas)?;
        Ok(())
    }

    /// Where it listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Where its own metrics are.
    pub fn metrics(&self) -> SocketAddr {
        self.metrics
    }

    /// The folder of its cache.
    pub fn cache(&self) -> PathBuf {
        self.folder.join("cache")
    }

    /// Ends it; its cache and its addresses stay for [`Nginx::restart`].
    pub fn stop(&mut self) {
        process::stop(&mut self.child, END_WITHIN);
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

/// Writes the configuration and waits until nginx listens.
fn spawn(folder: &Path, [address, metrics]: [SocketAddr; 2], replicas: &[SocketAddr]) -> Result<Child> {
    for (name, text) in [
        ("nginx.conf", CONFIGURATION.to_owned()),
        ("listen.conf", format!("listen {address} backlog=4096;\n")),
        ("metrics.conf", format!("listen {metrics};\n")),
        ("replicas.conf", replicas_of(replicas, folder)),
    ] {
        std::fs::write(folder.join(name), text).with_context(|| format!("cannot write {name}"))?;
    }
    let mut child = command(folder)
        .args(["-g", &format!("daemon off; pid {}/pid;", folder.display())])
        .stdin(Stdio::null())
        // The log of requests.
        .stdout(Stdio::null())
        .spawn()
        .context("cannot start nginx; on Debian and Ubuntu: apt-get install nginx")?;
    let deadline = Instant::now() + READY_WITHIN;
    while TcpStream::connect(address).is_err() {
        if !matches!(child.try_wait(), Ok(None)) || Instant::now() > deadline {
            process::stop(&mut child, END_WITHIN);
            bail!("nginx does not listen at {address}; its message is above");
        }
        sleep(Duration::from_millis(10));
    }
    Ok(child)
}

/// nginx with the configuration in a folder.
fn command(folder: &Path) -> Command {
    let mut command = process::command("nginx");
    command.arg("-p").arg(folder).arg("-c").arg(folder.join("nginx.conf"));
    command
}

/// Whether nginx accepts the files of `deploy/nginx`, with the loopback in place of the names of
/// replicas and without the lookup of names, and rejects them with an unknown directive.
///
/// # Errors
/// It rejects them, or accepts what is invalid.
pub fn check() -> Result<()> {
    let folder = super::folder("nginx-check")?;
    std::fs::create_dir_all(folder.join("temporary"))?;
    let (given, place) = (process::root().join("deploy/nginx"), folder.display().to_string());
    for entry in std::fs::read_dir(&given)? {
        let (path, name) = entry.map(|entry| (entry.path(), entry.file_name()))?;
        let mut text = std::fs::read_to_string(&path)?.replace("/var/cache/nginx", &place);
        (1..10).for_each(|n| text = text.replace(&format!("replica-{n}:"), "127.0.0.1:"));
        if name == "replicas.conf" {
            // The nginx of Debian 12 is older than these (1.27.3).
            text = text.replace(" resolve;", ";");
            text.push_str(&temporary_folders(&folder));
        }
        std::fs::write(folder.join(name), text)?;
    }
    let test = || {
        let mut test = command(&folder);
        test.args(["-t", "-g", &format!("pid {place}/pid;")]);
        test
    };
    process::run(test()).context("nginx rejects deploy/nginx")?;
    let listen = std::fs::read_to_string(folder.join("listen.conf"))?;
    std::fs::write(folder.join("listen.conf"), format!("{listen}\nno_such_directive on;\n"))?;
    ensure!(!process::succeeds(test()), "the control: nginx accepts an unknown directive");
    // Results of a build may stay: a failed removal is harmless.
    let _ = std::fs::remove_dir_all(&folder);
    Ok(())
}

/// The file of the upstreams, with the folders that a container has elsewhere.
fn replicas_of(replicas: &[SocketAddr], folder: &Path) -> String {
    let mut text = String::new();
    for (name, rule, more) in
        [("sessions", "least_conn;", ""), ("chunks", "hash $uri consistent;", "keepalive 32;")]
    {
        writeln!(text, "upstream {name} {{ zone upstream_{name} 64k; {rule}").expect("a string");
        for address in replicas {
            writeln!(text, "    server {address} max_fails=0;").expect("a string");
        }
        writeln!(text, "{more} }}").expect("a string");
    }
    writeln!(
        text,
        "proxy_cache_path {}/cache levels=1:2 keys_zone=chunks:128m max_size=1g inactive=1h \
         use_temp_path=off;",
        folder.display()
    )
    .expect("a string");
    text + &temporary_folders(folder)
}

/// Directives for folders that nginx has elsewhere where it is installed, which not every user may
/// write.
fn temporary_folders(folder: &Path) -> String {
    let kinds = ["client_body", "proxy", "fastcgi", "uwsgi", "scgi"];
    let path = |kind| format!("{kind}_temp_path {}/temporary/{kind};\n", folder.display());
    kinds.map(path).concat()
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
            "zone upstream_sessions 64k;",
            "zone upstream_chunks 64k;",
            " max_fails=0",
            "keepalive 32;",
            "keys_zone=chunks:128m",
        ] {
            assert!(container.contains(part) && desk.contains(part), "{part}");
        }
        // No server of either counts failures, which would let one client take it out.
        // A name that is looked up once at the start keeps nginx from starting without its replica.
        for (text, replicas, end) in [(container, 2, " max_fails=0 resolve;"), (&desk, 1, " max_fails=0;")] {
            assert_eq!(text.matches("server ").count(), 2 * replicas);
            assert_eq!(text.matches(end).count(), 2 * replicas);
        }
        assert!(container.contains("\nresolver 127.0.0.11 "));
        // Requirements of the configuration on both.
        for part in ["http://sessions", "http://chunks", "proxy_cache chunks;", "include replicas.conf;"] {
            assert!(CONFIGURATION.contains(part), "{part}");
        }
    }

    /// A worker may open a file for each connection and one for each answer of the cache.
    #[test]
    fn a_worker_may_open_twice_as_many_files_as_connections() {
        let number = |directive: &str| -> u32 {
            let mut lines = CONFIGURATION.lines().filter_map(|line| line.trim().strip_prefix(directive));
            let (Some(value), None) = (lines.next(), lines.next()) else { panic!("{directive}") };
            value.trim_end_matches(';').parse().unwrap()
        };
        assert_eq!(number("worker_rlimit_nofile "), 2 * number("worker_connections "));
        // A client takes two connections, one of its own and one to a replica. The metric has the
        // clients of one worker; one address gets a quarter of them.
        assert_eq!(2 * number("nginx_connections_limit "), number("worker_connections "));
        assert_eq!(4 * 2 * number("limit_conn addresses "), number("worker_connections "));
    }

    /// With no mark between address and style, `1/2?style=3` and `1/23` would share an answer.
    #[test]
    fn the_key_of_the_cache_keeps_address_and_style_apart() {
        let keys: Vec<_> =
            CONFIGURATION.lines().filter_map(|line| line.trim().strip_prefix("proxy_cache_key ")).collect();
        assert_eq!(keys, ["$uri?$arg_style;"]);
    }
}
