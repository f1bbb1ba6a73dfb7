//! The built programs, run as a user or a script runs them.

use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Child, Command, Output, Stdio};
use std::sync::OnceLock;

/// A program by its name, built if it is not up to date; by `TOMBOLO_PROGRAMS_BUILT` it is.
#[must_use]
pub fn command(name: &str) -> Command {
    static BUILT: OnceLock<()> = OnceLock::new();
    BUILT.get_or_init(|| {
        // `cargo ci` has just built them.
        if std::env::var_os("TOMBOLO_PROGRAMS_BUILT").is_none() {
            build();
        }
    });
    let mut command = Command::new(directory().join(name));
    // Without it, a Vulkan layer of Mesa writes a line to standard error.
    command.env("XDG_RUNTIME_DIR", std::env::temp_dir());
    // The environment of a developer must not change a test.
    for (variable, _) in std::env::vars_os() {
        if variable.to_string_lossy().starts_with("TOMBOLO_") {
            command.env_remove(variable);
        }
    }
    command
}

/// Builds the whole workspace, as continuous integration does: a part would be built with other
/// features.
fn build() {
    let mut cargo = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    // The variables that cargo sets for the package of the test. A build script of a dependency
    // reads these variables: with other values than in a shell it would run again, and all that
    // needs it be built.
    for (name, _) in std::env::vars_os() {
        let is_of_the_test = |prefix| name.to_string_lossy().starts_with(prefix);
        if is_of_the_test("CARGO_PKG_") || is_of_the_test("CARGO_MANIFEST_") {
            cargo.env_remove(&name);
        }
    }
    let built = cargo.args(["build", "--quiet", "--workspace", "--all-targets"]).status();
    assert!(built.is_ok_and(|status| status.success()), "the programs build");
}

/// Where cargo puts the programs: two levels above the running test.
fn directory() -> PathBuf {
    let test = std::env::current_exe().expect("the running test has a path");
    test.ancestors().nth(2).expect("tests run from target/PROFILE/deps").to_owned()
}

/// Runs a program to its end.
///
/// # Panics
/// The program cannot be started.
#[must_use]
pub fn run(name: &str, arguments: &[&str]) -> Output {
    command(name).args(arguments).output().expect("the program starts")
}

/// Standard error as text.
#[must_use]
pub fn errors(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).trim_end().to_owned()
}

/// A running `tombolo-server` on a free port; killed when dropped.
pub struct ServerProgram {
    /// The process.
    pub child: Child,
    /// `ADDR:PORT`.
    pub address: String,
}

impl ServerProgram {
    /// Starts the server and waits for the line with its address.
    ///
    /// # Panics
    /// The server does not print its address.
    #[must_use]
    pub fn start(arguments: &[&str]) -> Self {
        Self::start_at("127.0.0.1:0", arguments)
    }

    /// Starts the server at an address, for suites that restart one.
    ///
    /// # Panics
    /// The server does not print its address.
    #[must_use]
    pub fn start_at(address: &str, arguments: &[&str]) -> Self {
        let mut child = command("tombolo-server")
            .args(["--listen", address])
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the server starts");
        let mut line = String::new();
        let output = child.stdout.as_mut().expect("standard output is piped");
        BufReader::new(output).read_line(&mut line).expect("the server prints its address");
        let address = line.trim().strip_prefix("listening on http://").expect("an address").to_owned();
        Self { child, address }
    }

    /// The WebSocket URL of the stream endpoint.
    #[must_use]
    pub fn stream_url(&self) -> String {
        format!("ws://{}/v1/stream", self.address)
    }

    /// Sends a signal by name, for example `TERM`.
    ///
    /// # Panics
    /// There is no `kill` command.
    pub fn signal(&self, name: &str) {
        let killed = Command::new("kill").args([&format!("-{name}"), &self.child.id().to_string()]).status();
        assert!(killed.expect("the kill command exists").success());
    }
}

impl Drop for ServerProgram {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
