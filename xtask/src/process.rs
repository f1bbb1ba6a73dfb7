//! Child processes: run one to its end, capture what it says, stop it politely. Nothing outlives an
//! interrupt.

use anyhow::{Context, Result, bail};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, ExitStatus, Stdio};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// How often a waiting parent looks at its child and at the interrupt flag.
const POLL: Duration = Duration::from_millis(20);

static INTERRUPTED: AtomicBool = AtomicBool::new(false);
static DIST: AtomicBool = AtomicBool::new(false);

/// From now on SIGINT and SIGTERM set a flag instead of killing this process, so that children can
/// be stopped first.
pub fn catch_interrupts() -> Result<()> {
    ctrlc::set_handler(|| INTERRUPTED.store(true, Ordering::Relaxed)).context("cannot catch Ctrl-C")
}

/// Whether SIGINT or SIGTERM arrived.
pub fn interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

/// The workspace's root folder: of the checkout that cargo runs this from, which need not be where
/// it was built.
pub fn root() -> PathBuf {
    let here = std::env::var_os("CARGO_MANIFEST_DIR")
        .map_or_else(|| env!("CARGO_MANIFEST_DIR").into(), PathBuf::from);
    here.parent().map(Path::to_path_buf).unwrap_or(here)
}

/// The folder of build results.
pub fn target() -> PathBuf {
    std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| root().join("target"), |folder| root().join(folder))
}

/// From now on programs are those of the `dist` profile, which is measured and shipped. Without it
/// they are those of `release`, which builds faster.
pub fn use_dist_profile() {
    DIST.store(true, Ordering::Relaxed);
}

fn profile() -> &'static str {
    if DIST.load(Ordering::Relaxed) { "dist" } else { "release" }
}

/// A program of the workspace, built by [`build`].
pub fn program(name: &str) -> PathBuf {
    built(profile(), name)
}

/// A program of the workspace as its tests run it, built by `cargo build`.
pub fn tested_program(name: &str) -> PathBuf {
    built("debug", name)
}

fn built(folder: &str, name: &str) -> PathBuf {
    triple().map_or_else(target, |triple| target().join(triple)).join(folder).join(name)
}

/// The target that a person has configured, by `build.target` or its variable; none without one.
/// Cargo has put this program into a folder of that name. What it builds without one lies
/// elsewhere, and no option switches a configured one off, so each build names it.
fn triple() -> Option<&'static str> {
    static TRIPLE: OnceLock<Option<String>> = OnceLock::new();
    TRIPLE.get_or_init(|| triple_of(&std::env::current_exe().ok()?, &target(), is_triple)).as_deref()
}

/// The target of a program by the folder around its profile's folder, unless that is the folder of
/// all build results.
fn triple_of(program: &Path, target: &Path, is_triple: impl Fn(&str) -> bool) -> Option<String> {
    let folder = program.parent()?.parent().filter(|folder| *folder != target)?;
    let name = folder.file_name()?.to_str()?;
    is_triple(name).then(|| name.to_owned())
}

fn is_triple(name: &str) -> bool {
    let mut list = command("rustc");
    list.args(["--print", "target-list"]);
    // All have one, and most folders of build results have none: then the compiler is not asked.
    name.contains('-') && output(list).is_ok_and(|list| list.lines().any(|triple| triple == name))
}

/// A command that builds programs. They are chosen among the whole workspace: a package that is
/// chosen alone is built with other features, and so are all of its dependencies.
pub fn build(programs: &[&str]) -> Command {
    compile("build", profile(), programs, triple())
}

/// An example of the server's package, built by [`build_example`].
pub fn example(name: &str) -> PathBuf {
    program("examples").join(name)
}

/// A command that builds an example of the server's package.
pub fn build_example(name: &str) -> Command {
    let mut command = build(&[]);
    command.args(["--example", name]);
    command
}

/// The command that builds programs as [`tested_program`] names them.
pub fn build_tested(programs: &[&str]) -> Command {
    compile("build", "dev", programs, triple())
}

/// As [`build`], with a viewer that only draws into files: the window is half of what a viewer
/// takes to build.
pub fn build_without_window(programs: &[&str]) -> Command {
    without_window(build(programs))
}

/// Looks whether [`build_without_window`] would succeed, without making programs.
pub fn check_without_window(programs: &[&str]) -> Command {
    without_window(compile("check", "dev", programs, triple()))
}

fn without_window(mut command: Command) -> Command {
    command.arg("--no-default-features");
    command
}

/// A subcommand on programs, with results where [`program`] looks for them: a person may have
/// configured another folder, or another target.
fn compile(subcommand: &str, profile: &str, programs: &[&str], triple: Option<&str>) -> Command {
    let mut compile = cargo(&format!("{subcommand} --profile {profile}"));
    compile.arg("--target-dir").arg(target());
    compile.args(triple.into_iter().flat_map(|triple| ["--target", triple]));
    compile.args(programs.iter().flat_map(|program| ["--bin", program]));
    compile
}

/// A command in the workspace's root.
pub fn command(program: impl AsRef<Path>) -> Command {
    let mut command = Command::new(program.as_ref());
    command.current_dir(root());
    command
}

/// The viewer.
pub fn viewer() -> Command {
    let mut viewer = command(program("tombolo-view"));
    quiet_drivers(&mut viewer);
    viewer
}

/// For a program that opens a GPU: a Vulkan layer of Mesa looks for a Wayland socket in the runtime
/// directory and complains where that variable is unset, as in containers.
pub fn quiet_drivers(command: &mut Command) {
    if std::env::var_os("XDG_RUNTIME_DIR").is_none() {
        command.env("XDG_RUNTIME_DIR", std::env::temp_dir());
    }
}

/// The cargo that runs this program, with arguments given as one line of words.
pub fn cargo(line: &str) -> Command {
    let mut cargo = command(std::env::var_os("CARGO").map_or_else(|| "cargo".into(), PathBuf::from));
    cargo.args(line.split_whitespace());
    // What the cargo that runs this program says of it. A build script of a dependency reads these
    // names: with other values than in a shell it would run again, and all that needs it be built.
    let is_ours = |name: &str| name.starts_with("CARGO_PKG_") || name.starts_with("CARGO_MANIFEST_");
    // `vars` panics where any variable is not UTF-8.
    for (name, _) in std::env::vars_os().filter(|(name, _)| name.to_str().is_some_and(is_ours)) {
        cargo.env_remove(name);
    }
    cargo
}

/// Runs a command to a successful end; its output goes where ours goes.
///
/// # Errors
/// The command cannot start, fails, or is interrupted.
pub fn run(mut command: Command) -> Result<()> {
    let status = status(&mut command)?;
    if !status.success() {
        bail!("`{}` failed ({status})", shown(&command));
    }
    Ok(())
}

/// As [`run`], where a failing command is an answer too.
///
/// # Errors
/// The command cannot start or is interrupted.
pub fn status(command: &mut Command) -> Result<ExitStatus> {
    let child = command.spawn().with_context(|| format!("cannot start `{}`", shown(command)))?;
    wait(child)
}

/// Standard output of a command.
///
/// # Errors
/// The command cannot start or fails; the message carries the last line that it wrote to standard
/// error.
pub fn output(mut command: Command) -> Result<String> {
    let output = command
        .stdin(Stdio::null())
        .output()
        .with_context(|| format!("cannot start `{}`", shown(&command)))?;
    if !output.status.success() {
        let said = String::from_utf8_lossy(&output.stderr);
        let last = said.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("it said nothing").trim();
        bail!("`{}` failed ({}): {last}", shown(&command), output.status);
    }
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// Whether a command can be run and succeeds; its output is discarded.
pub fn succeeds(mut command: Command) -> bool {
    command
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success())
}

/// Waits for a child; stops it when an interrupt arrives.
fn wait(mut child: Child) -> Result<ExitStatus> {
    loop {
        if let Some(status) = child.try_wait().context("cannot wait for a child process")? {
            if interrupted() {
                bail!("interrupted");
            }
            return Ok(status);
        }
        if interrupted() {
            stop(&mut child, Duration::from_secs(5));
            bail!("interrupted");
        }
        sleep(POLL);
    }
}

/// Ends a child: SIGTERM, and SIGKILL after the timeout. Does nothing to a child that has ended.
pub fn stop(child: &mut Child, timeout: Duration) {
    if !matches!(child.try_wait(), Ok(None)) {
        return;
    }
    // The standard library has no SIGTERM; the system's `kill` has.
    let _ = Command::new("kill").args(["-TERM", &child.id().to_string()]).status();
    let deadline = Instant::now() + timeout;
    while Instant::now() < deadline {
        if !matches!(child.try_wait(), Ok(None)) {
            return;
        }
        sleep(POLL);
    }
    let _ = child.kill();
    let _ = child.wait();
}

/// A command as a person would type it.
pub fn shown(command: &Command) -> String {
    let program = Path::new(command.get_program()).file_name().unwrap_or(command.get_program());
    let words = std::iter::once(program).chain(command.get_args());
    words.map(|word| quoted(&word.to_string_lossy())).collect::<Vec<_>>().join(" ")
}

fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./=:,+@".contains(c);
    if !word.is_empty() && word.chars().all(plain) { word.into() } else { format!("'{word}'") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_shown_as_one_would_type_them() {
        let mut command = Command::new("/usr/bin/env");
        command.args(["a", "two words", "--flag=1"]);
        assert_eq!(shown(&command), "env a 'two words' --flag=1");
    }

    #[test]
    fn programs_are_built_where_they_are_looked_for() {
        let folder = target().display().to_string();
        let words = |triple| {
            let command = compile("build", profile(), &["a", "b"], triple);
            command.get_args().map(|word| word.to_string_lossy().into_owned()).collect::<Vec<_>>().join(" ")
        };
        let profile = profile();
        assert_eq!(words(None), format!("build --profile {profile} --target-dir {folder} --bin a --bin b"));
        assert!(words(Some("x-y")).contains(&format!("--target-dir {folder} --target x-y --bin a")));
        assert!(program("a").starts_with(target()));
    }

    #[test]
    fn a_folder_named_like_a_target_is_a_configured_one_and_any_other_is_not() {
        let is_triple = |name: &str| name == "x86_64-unknown-linux-musl";
        let of = |target: &str, program: &str| triple_of(Path::new(program), Path::new(target), is_triple);
        let program = "/a/x86_64-unknown-linux-musl/debug/xtask";
        assert_eq!(of("/a", program).as_deref(), Some("x86_64-unknown-linux-musl"));
        assert_eq!(of("/a/x86_64-unknown-linux-musl", program), None);
        for other in ["/a/target/debug/xtask", "/x86_64-unknown-linux-musl/a/debug/xtask", "xtask", "/"] {
            assert_eq!(of("/a", other), None, "{other}");
        }
        assert!(super::is_triple("wasm32-unknown-unknown") && !super::is_triple("cargo-target-dir"));
    }

    #[cfg(unix)]
    #[test]
    fn variables_of_this_cargo_are_removed_also_beside_one_that_is_not_utf_8() {
        use std::os::unix::ffi::OsStrExt;
        const NAME: &str =
            "process::tests::variables_of_this_cargo_are_removed_also_beside_one_that_is_not_utf_8";
        if std::env::var_os("CARGO_PKG_PLANTED").is_some() {
            let cargo = cargo("version");
            let is_removed =
                |name: &str| cargo.get_envs().any(|(other, value)| other == name && value.is_none());
            assert!(is_removed("CARGO_PKG_PLANTED") && !is_removed("TOMBOLO_PLANTED"));
            return;
        }
        // Variables are set only for another process: this one has threads that read them.
        let mut again = Command::new(std::env::current_exe().unwrap());
        again
            .args(["--exact", NAME])
            .env("CARGO_PKG_PLANTED", "1")
            .env("TOMBOLO_PLANTED", std::ffi::OsStr::from_bytes(b"\xff"));
        let said = output(again).unwrap();
        assert!(said.contains("1 passed"), "{said}");
    }

    #[test]
    fn failures_carry_the_command_and_its_last_words() {
        let mut command = Command::new("sh");
        command.args(["-c", "echo first >&2; echo last >&2; exit 3"]);
        let error = output(command).unwrap_err().to_string();
        assert!(error.contains("sh -c") && error.ends_with("last"), "{error}");
        assert!(run(Command::new("false")).is_err() && run(Command::new("true")).is_ok());
        assert!(run(Command::new("no-such-program")).unwrap_err().to_string().contains("no-such-program"));
    }

    #[test]
    fn a_child_that_ignores_the_request_is_killed() {
        let mut child = Command::new("sh")
            .args(["-c", "trap '' TERM; echo ready; while :; do sleep 0.05; done"])
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        // Before its trap is set the request would end it.
        let mut ready = [0; 5];
        std::io::Read::read_exact(child.stdout.as_mut().unwrap(), &mut ready).unwrap();
        stop(&mut child, Duration::from_millis(200));
        let status = child.try_wait().unwrap().unwrap();
        assert_eq!(std::os::unix::process::ExitStatusExt::signal(&status), Some(9));
    }
}
