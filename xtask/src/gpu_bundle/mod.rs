//! `gpu-bundle`: what a machine with a GPU needs for the checks that ask for one, in one archive;
//! `gpu-record`: the record of such a run.
//!
//! Machines with a GPU are borrowed for minutes and may have no toolchain and no network. The
//! bundle holds stripped programs, a script, and this program for the bars.

mod record;

pub use record::write as record;

use crate::{machine, process};
use anyhow::{Context, Result, bail};
use std::path::Path;

/// Programs in the bundle.
const PROGRAMS: [&str; 4] = ["tombolo-lab", "tombolo-server", "tombolo-view", "xtask"];

/// Largest archive, bytes.
const LIMIT: u64 = 60 << 20;

/// The script for the other machine.
const SCRIPT: &str = include_str!("run.sh");

/// Builds the programs and packs the archive.
///
/// # Errors
/// A build or a copy fails, or the archive is larger than [`LIMIT`].
pub fn build() -> Result<()> {
    process::use_dist_profile();
    let begun = machine::commit();
    process::run(process::build(&PROGRAMS)).context("gpu-bundle: the build failed")?;
    let folder = process::target().join("gpu-bundle");
    let root = folder.join("tombolo-gpu");
    // An older bundle may hold other files.
    let _ = std::fs::remove_dir_all(&root);
    let bin = root.join("bin");
    std::fs::create_dir_all(&bin).with_context(|| format!("cannot create {}", bin.display()))?;
    for program in PROGRAMS {
        let copy = bin.join(program);
        std::fs::copy(process::program(program), &copy)
            .with_context(|| format!("gpu-bundle: cannot copy {program}"))?;
        let mut strip = process::command("strip");
        strip.arg("--strip-unneeded").arg(&copy);
        process::run(strip).context("gpu-bundle: `strip` (binutils) is needed")?;
    }
    let commit = begun.until(machine::commit());
    let state = if commit.is_clean { "" } else { " with uncommitted changes: a draft" };
    std::fs::write(root.join("commit"), format!("{}{state}\n", commit.hash)).context("gpu-bundle")?;
    let script = root.join("run.sh");
    std::fs::write(&script, SCRIPT).context("gpu-bundle")?;
    make_executable(&script)?;
    let archive = folder.join("tombolo-gpu.tar.gz");
    let mut tar = process::command("tar");
    tar.arg("-czf").arg(&archive).arg("-C").arg(&folder).arg("tombolo-gpu");
    process::run(tar).context("gpu-bundle: cannot pack")?;
    let bytes = std::fs::metadata(&archive).context("gpu-bundle")?.len();
    let mib = bytes as f64 / f64::from(1 << 20);
    println!("gpu-bundle: {} ({mib:.1} MiB); unpack it and run tombolo-gpu/run.sh", archive.display());
    if bytes > LIMIT {
        bail!("gpu-bundle: {mib:.1} MiB, at most {} MiB", LIMIT >> 20);
    }
    Ok(())
}

#[cfg(unix)]
fn make_executable(path: &Path) -> Result<()> {
    use std::os::unix::fs::PermissionsExt;
    std::fs::set_permissions(path, std::fs::Permissions::from_mode(0o755)).context("gpu-bundle")
}

#[cfg(not(unix))]
fn make_executable(_: &Path) -> Result<()> {
    bail!("gpu-bundle: bundles are made on Linux")
}
