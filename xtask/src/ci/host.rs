//! The machine that a run of `ci` looks at: its tools, and how commands are run on it. A trait, so
//! that `super::rehearsal` can hide one tool at a time.

use crate::fast_simd;
use crate::land_version_3;
use crate::process;
use crate::records;
use crate::setup;
use anyhow::{Context, Result};
use serde_json::Value;
use std::ffi::{OsStr, OsString};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The target of browsers.
pub const WASM: &str = "wasm32-unknown-unknown";

/// Requirements of a check that a machine may lack.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tool {
    /// `cargo fmt`.
    Rustfmt,
    /// `cargo clippy`.
    Clippy,
    /// `cargo nextest`.
    Nextest,
    /// `cargo deny`.
    Deny,
    /// A Vulkan driver, a software one included.
    Vulkan,
    /// An OpenGL driver.
    OpenGl,
    /// The X server without a screen that windows are opened on.
    Xvfb,
    /// The browser.
    Chromium,
    /// The Vulkan driver that comes with Chromium.
    SwiftShader,
    /// Dawn's shader compiler.
    Tint,
    /// The target `wasm32-unknown-unknown` of the Rust toolchain.
    WasmTarget,
    /// Node, which runs the WebAssembly module.
    Node,
    /// clang, which FastNoise2 is fastest with.
    Clang,
    /// CMake and make, which build FastNoise2.
    Cmake,
    /// The sources of FastSIMD, which the build of FastNoise2 downloads from GitHub.
    FastSimd,
    /// libclang, which the bindings of LERC are made with.
    Libclang,
    /// The commits of land version 3 and of the records, which a shallow clone has not.
    History,
    /// The proxy before replicas.
    Nginx,
    /// Checks the rules of Prometheus.
    Promtool,
}

impl Tool {
    /// All of them.
    pub const ALL: [Self; 19] = [
        Self::Rustfmt,
        Self::Clippy,
        Self::Nextest,
        Self::Deny,
        Self::Vulkan,
        Self::OpenGl,
        Self::Xvfb,
        Self::Chromium,
        Self::SwiftShader,
        Self::Tint,
        Self::WasmTarget,
        Self::Node,
        Self::Clang,
        Self::Cmake,
        Self::FastSimd,
        Self::Libclang,
        Self::History,
        Self::Nginx,
        Self::Promtool,
    ];

    /// Its name for `--allow-skips`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Rustfmt => "rustfmt",
            Self::Clippy => "clippy-driver",
            Self::Nextest => "nextest",
            Self::Deny => "cargo-deny",
            Self::Vulkan => "vulkan",
            Self::OpenGl => "opengl",
            Self::Xvfb => "xvfb",
            Self::Chromium => "chromium",
            Self::SwiftShader => "swiftshader",
            Self::Tint => "tint",
            Self::WasmTarget => "wasm-target",
            Self::Node => "node",
            Self::Clang => "clang",
            Self::Cmake => "cmake",
            Self::FastSimd => "fastsimd",
            Self::Libclang => "libclang",
            Self::History => "history",
            Self::Nginx => "nginx",
            Self::Promtool => "promtool",
        }
    }
}

/// A machine.
pub trait Host {
    /// Announces a step before its output.
    fn begin(&self, step: &str, about: &str);

    /// Why a tool cannot be used; none if it can. Only looks: nothing is installed or downloaded.
    fn lacks(&self, tool: Tool) -> Option<String>;

    /// Runs a command to a successful end; its output goes where ours goes.
    ///
    /// # Errors
    /// The command cannot start, fails, or is interrupted.
    fn run(&self, command: Command) -> Result<()>;

    /// Standard output of a command.
    ///
    /// # Errors
    /// The command cannot start or fails.
    fn output(&self, command: Command) -> Result<String>;

    /// The JSON that a successful command leaves in a file.
    ///
    /// # Errors
    /// The command fails or leaves no JSON.
    fn report(&self, command: Command, json: &Path) -> Result<Value>;

    /// Runs a check of this program.
    ///
    /// # Errors
    /// Those of the check.
    fn own(&self, check: fn() -> Result<()>) -> Result<()>;
}

/// The machine that this program runs on.
#[derive(Clone, Debug)]
pub struct Here {
    /// Folders of programs, as in `PATH`.
    path: OsString,
    /// Tools whose download failed, and why.
    refused: Vec<(Tool, String)>,
}

impl Here {
    /// With the `PATH` of this process.
    pub fn new() -> Self {
        Self { path: std::env::var_os("PATH").unwrap_or_default(), refused: Vec::new() }
    }

    /// As [`Here::new`], after a download of what is missing and is in no package of the system.
    pub fn with_downloads() -> Self {
        let failed = |(tool, why): (Tool, Result<()>)| Some((tool, format!("{:#}", why.err()?)));
        let downloads = [(Tool::WasmTarget, add_target(WASM)), (Tool::FastSimd, fast_simd::fetch())];
        Self { refused: downloads.into_iter().filter_map(failed).collect(), ..Self::new() }
    }

    fn program(&self, name: &str) -> Option<PathBuf> {
        std::env::split_paths(&self.path).map(|folder| folder.join(name)).find(|path| path.is_file())
    }

    fn lacks_program(&self, name: &str, package: &str) -> Option<String> {
        self.program(name).is_none().then(|| not_on_path(package))
    }

    /// Debian's package `tint` is a game, so the name alone proves nothing.
    fn lacks_tint(&self) -> Option<String> {
        let Some(program) = self.program("tint") else {
            return Some(
                "not on PATH; no distribution has it, build it from https://dawn.googlesource.com/dawn"
                    .into(),
            );
        };
        let mut help = Command::new(&program);
        help.arg("--help").stdin(Stdio::null());
        let said = help.output().map(|output| [output.stdout, output.stderr].concat()).unwrap_or_default();
        let is_compiler = String::from_utf8_lossy(&said).to_lowercase().contains("wgsl");
        (!is_compiler).then(|| format!("{} is not Dawn's shader compiler", program.display()))
    }
}

/// Why the Rust toolchain cannot build for a target; none if it can.
fn lacks_target(target: &str) -> Option<String> {
    let mut libraries = process::command("rustc");
    libraries.args(["--print", "target-libdir", "--target", target]);
    let is_there = process::output(libraries).is_ok_and(|folder| Path::new(folder.trim()).is_dir());
    (!is_there).then(|| format!("not installed; run: rustup target add {target}"))
}

/// Adds a target to the Rust toolchain, unless it is there.
fn add_target(target: &str) -> Result<()> {
    if lacks_target(target).is_none() {
        return Ok(());
    }
    println!("ci: adding the target {target}");
    let mut add = process::command("rustup");
    add.args(["target", "add", target]);
    process::output(add).map(drop).context("not installed and cannot be")
}

/// The newest clang and clang++ on `PATH`.
pub fn clang() -> Option<(PathBuf, PathBuf)> {
    clang_on(&std::env::var_os("PATH")?)
}

fn clang_on(path: &OsStr) -> Option<(PathBuf, PathBuf)> {
    let folders: Vec<_> = std::env::split_paths(path).collect();
    let find = |name: String| folders.iter().map(|folder| folder.join(&name)).find(|p| p.is_file());
    // Debian names them by version; 14 is the oldest that has been tried.
    let suffixes = (14..40).rev().map(|version| format!("-{version}")).chain([String::new()]);
    suffixes.into_iter().find_map(|end| find(format!("clang{end}")).zip(find(format!("clang++{end}"))))
}

/// Why a program of a Debian package is missing.
fn not_on_path(package: &str) -> String {
    format!("not on PATH; on Debian or Ubuntu install `{package}`")
}

impl Host for Here {
    fn begin(&self, step: &str, about: &str) {
        println!("\n== {step}: {about}");
    }

    fn lacks(&self, tool: Tool) -> Option<String> {
        let subcommand = |probe: &str, cure: &str| {
            (!process::succeeds(process::cargo(probe))).then(|| format!("`cargo {probe}` fails; {cure}"))
        };
        if let Some((_, why)) = self.refused.iter().find(|(refused, _)| *refused == tool) {
            return Some(why.clone());
        }
        match tool {
            Tool::Rustfmt => subcommand("fmt --version", "run: rustup component add rustfmt"),
            Tool::Clippy => subcommand("clippy --version", "run: rustup component add clippy"),
            Tool::Nextest => subcommand("nextest --version", "run: cargo install cargo-nextest"),
            Tool::Deny => subcommand("deny --version", "run: cargo install cargo-deny"),
            // Whether drivers work only a program that opens them can tell; see the step `digest`.
            Tool::Vulkan => {
                (!setup::has_vulkan_driver()).then(|| "no driver; install `mesa-vulkan-drivers`".into())
            }
            Tool::OpenGl => (!setup::has_egl()).then(|| "no driver; install `libegl1`".into()),
            Tool::Xvfb => self.lacks_program("Xvfb", "xvfb"),
            Tool::Chromium => {
                installed_browser::chromium_on(&self.path).is_none().then(|| not_on_path("chromium"))
            }
            Tool::SwiftShader => (!setup::has_swiftshader()).then(|| "it comes with `chromium`".into()),
            Tool::Tint => self.lacks_tint(),
            Tool::WasmTarget => lacks_target(WASM),
            Tool::Node => self.lacks_program("node", "nodejs"),
            Tool::Clang => clang_on(&self.path).is_none().then(|| "not on PATH; install `clang-19`".into()),
            Tool::Cmake => {
                self.lacks_program("cmake", "cmake").or_else(|| self.lacks_program("make", "make"))
            }
            Tool::FastSimd => (!fast_simd::is_fetched())
                .then(|| "the build of FastNoise2 needs it; a run of all steps clones it".into()),
            Tool::Libclang => (!setup::has_libclang()).then(|| "not found; install `libclang-dev`".into()),
            Tool::History => land_version_3::lacks().or_else(records::lacks_history),
            Tool::Nginx => self.lacks_program("nginx", "nginx-light"),
            Tool::Promtool => self.lacks_program("promtool", "prometheus"),
        }
    }

    fn run(&self, command: Command) -> Result<()> {
        process::run(command)
    }

    fn output(&self, command: Command) -> Result<String> {
        process::output(command)
    }

    fn report(&self, command: Command, json: &Path) -> Result<Value> {
        // A report of an earlier run must not pass for one of this.
        let _ = std::fs::remove_file(json);
        process::run(command)?;
        let text = std::fs::read_to_string(json).with_context(|| format!("no report {}", json.display()))?;
        serde_json::from_str(&text).with_context(|| format!("{} is not JSON", json.display()))
    }

    fn own(&self, check: fn() -> Result<()>) -> Result<()> {
        check()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Tools that are programs on `PATH`.
    const PROGRAMS: [(Tool, &str); 5] = [
        (Tool::Chromium, "chromium"),
        (Tool::Tint, "tint"),
        (Tool::Node, "node"),
        (Tool::Clang, "clang"),
        (Tool::Cmake, "cmake"),
    ];

    #[test]
    fn programs_are_missing_from_an_empty_path_and_found_in_a_folder_of_it() {
        let folder = std::env::temp_dir().join(format!("tombolo-host-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let here = Here { path: folder.clone().into_os_string(), ..Here::new() };
        for (tool, name) in PROGRAMS {
            assert!(here.lacks(tool).is_some_and(|why| why.contains("not on PATH")), "{name}");
        }
        for name in ["chromium", "node", "clang", "clang++", "cmake", "make"] {
            std::fs::write(folder.join(name), "").unwrap();
        }
        for (tool, name) in PROGRAMS {
            assert_eq!(here.lacks(tool).is_none(), tool != Tool::Tint, "{name}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[cfg(unix)]
    #[test]
    fn a_program_called_tint_that_knows_no_wgsl_is_not_the_compiler() {
        use std::os::unix::fs::PermissionsExt;
        let folder = std::env::temp_dir().join(format!("tombolo-tint-name-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let here = Here { path: folder.clone().into_os_string(), ..Here::new() };
        for (says, is_compiler) in [("falling blocks", false), ("--format [spirv|wgsl]", true)] {
            let program = folder.join("tint");
            std::fs::write(&program, format!("#!/bin/sh\necho '{says}'\n")).unwrap();
            std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o755)).unwrap();
            assert_eq!(here.lacks(Tool::Tint).is_none(), is_compiler, "{says}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn a_download_that_failed_is_missing_for_its_reason() {
        let why = "no network".to_owned();
        let here = Here { refused: vec![(Tool::FastSimd, why.clone())], ..Here::new() };
        assert_eq!(here.lacks(Tool::FastSimd), Some(why.clone()));
        assert_ne!(here.lacks(Tool::Rustfmt), Some(why));
    }

    #[test]
    fn a_target_is_there_if_its_libraries_are() {
        let mut rustc = process::command("rustc");
        rustc.arg("-vV");
        let version = process::output(rustc).unwrap();
        let host = version.lines().find_map(|line| line.strip_prefix("host: ")).unwrap();
        assert_eq!(lacks_target(host), None);
        assert!(lacks_target("no-such-target").is_some_and(|why| why.ends_with("add no-such-target")));
    }

    #[test]
    fn a_report_of_an_earlier_run_does_not_count() {
        let json = std::env::temp_dir().join(format!("tombolo-report-{}.json", std::process::id()));
        std::fs::write(&json, "{}").unwrap();
        assert!(Here::new().report(Command::new("true"), &json).is_err());
        let mut write = Command::new("sh");
        write.arg("-c").arg("echo 3 > \"$0\"").arg(&json);
        assert_eq!(Here::new().report(write, &json).unwrap(), 3);
        std::fs::remove_file(&json).unwrap();
    }
}
