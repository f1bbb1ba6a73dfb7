//! A server with the interface of S3 on the loopback: `s3s-fs`, a program of its own, over a
//! folder. A relay stands before it, so that it can be slow.

use super::relay::Relay;
use crate::process;
use anyhow::{Context, Result, bail};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Version that the checks have run with.
const VERSION: &str = "0.14.1";

/// Its bucket.
const BUCKET: &str = "chunks";

/// Time until it must accept connections.
const READY_WITHIN: Duration = Duration::from_secs(5);

/// How requests are signed; the values are not secret.
const KEYS: (&str, &str) = ("tombolo", "tombolo-on-the-loopback");

/// A running server of objects. It ends with its folder when it goes out of scope.
#[derive(Debug)]
pub struct Objects {
    child: Child,
    relay: Relay,
    folder: PathBuf,
}

/// Why there is none on this machine; none if there is.
pub fn lacks() -> Option<String> {
    let mut version = process::command("s3s-fs");
    version.arg("--version");
    (!process::succeeds(version))
        .then(|| format!("needs s3s-fs: cargo install --locked s3s-fs --version {VERSION} --features binary"))
}

impl Objects {
    /// Starts it with a copy of the objects of another, or with an empty bucket.
    ///
    /// # Errors
    /// It is not installed or does not listen in time.
    pub fn start(name: &str, objects: Option<&Self>) -> Result<Self> {
        let folder = super::folder(&format!("objects-{name}"))?;
        match objects {
            Some(other) => {
                let mut copy = process::command("cp");
                copy.arg("-r").arg(other.folder.join(BUCKET)).arg(&folder);
                process::run(copy)?;
            }
            None => std::fs::create_dir(folder.join(BUCKET)).context("cannot create a bucket")?,
        }
        let address = TcpListener::bind("127.0.0.1:0")?.local_addr()?;
        let child = spawn(&folder, address)?;
        Ok(Self { child, relay: Relay::start(address)?, folder })
    }

    /// Settings of a server that uses it as its store.
    pub fn settings(&self) -> [(&'static str, String); 6] {
        [
            ("TOMBOLO_STORE", format!("s3://{BUCKET}/checks")),
            ("AWS_ENDPOINT", format!("http://{}", self.relay.address())),
            ("AWS_ALLOW_HTTP", "true".into()),
            ("AWS_REGION", "us-east-1".into()),
            ("AWS_ACCESS_KEY_ID", KEYS.0.into()),
            ("AWS_SECRET_ACCESS_KEY", KEYS.1.into()),
        ]
    }

    /// Ends it at once: connections are refused.
    pub fn kill(&mut self) {
        // It may have ended before.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }

    /// Stops it without an end: connections are accepted by the system, and nothing is answered.
    ///
    /// # Errors
    /// The system has no `kill`.
    pub fn hang(&self) -> Result<()> {
        self.run("kill", &["-STOP", &self.child.id().to_string()])
    }

    /// Ends [`Objects::hang`].
    ///
    /// # Errors
    /// The system has no `kill`.
    pub fn go_on(&self) -> Result<()> {
        self.run("kill", &["-CONT", &self.child.id().to_string()])
    }

    /// From now on every answer comes so much later.
    pub fn slow_down(&self, by: Duration) {
        self.relay.delay(by);
    }

    /// From now on nothing more can be written, as on a full disk: files may have no length.
    ///
    /// # Errors
    /// The system has no `prlimit`.
    pub fn fill_up(&self) -> Result<()> {
        self.run("prlimit", &["--pid", &self.child.id().to_string(), "--fsize=0:0"])
    }

    /// Changes a byte in the middle of every object. Returns their number.
    ///
    /// # Errors
    /// A file cannot be read or written.
    pub fn damage(&self) -> Result<usize> {
        let mut number = 0;
        for file in files(&self.folder.join(BUCKET))? {
            let mut bytes = std::fs::read(&file)?;
            let middle = bytes.len() / 2;
            if let Some(byte) = bytes.get_mut(middle) {
                *byte ^= 0x10;
                std::fs::write(&file, bytes).with_context(|| format!("cannot damage {}", file.display()))?;
                number += 1;
            }
        }
        Ok(number)
    }

    fn run(&self, program: &str, arguments: &[&str]) -> Result<()> {
        let mut command = Command::new(program);
        command.args(arguments);
        process::run(command)
    }
}

impl Drop for Objects {
    fn drop(&mut self) {
        self.kill();
        // Results of a build may stay: a failed removal is harmless.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}

fn spawn(folder: &Path, address: SocketAddr) -> Result<Child> {
    // A file that may not grow is an error of the write and not a signal: see `fill_up`.
    let mut child = process::command("sh")
        .args(["-c", "trap '' XFSZ; exec s3s-fs \"$@\"", "s3s-fs", "--host", "127.0.0.1", "--port"])
        .arg(address.port().to_string())
        .args(["--access-key", KEYS.0, "--secret-key", KEYS.1])
        .arg(folder)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .context("cannot start s3s-fs")?;
    let deadline = Instant::now() + READY_WITHIN;
    while TcpStream::connect(address).is_err() {
        if !matches!(child.try_wait(), Ok(None)) || Instant::now() > deadline {
            process::stop(&mut child, READY_WITHIN);
            bail!("s3s-fs does not listen at {address}");
        }
        sleep(Duration::from_millis(10));
    }
    Ok(child)
}

/// All files under a folder.
pub fn files(folder: &Path) -> Result<Vec<PathBuf>> {
    let (mut folders, mut files) = (vec![folder.to_owned()], Vec::new());
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder).with_context(|| folder.display().to_string())? {
            let path = entry?.path();
            if path.is_dir() { folders.push(path) } else { files.push(path) }
        }
    }
    files.sort();
    Ok(files)
}
