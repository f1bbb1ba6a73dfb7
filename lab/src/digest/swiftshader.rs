//! SwiftShader, the software Vulkan that comes with Chromium, under naga.
//!
//! A Vulkan loader reads which drivers to load when an instance is made, from the environment. So
//! this program runs itself once more with that variable set.

use crate::digest::child::ChildGuard;
use crate::digest::report::AdapterResults;
use anyhow::{Context, Result, bail};
use std::io::Read;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// All probes take a few seconds.
const TIME_LIMIT: Duration = Duration::from_secs(180);

/// Results of a child of this program that runs with that manifest.
///
/// # Errors
/// The child cannot be started, fails, or takes too long.
pub fn run(manifest: &Path) -> Result<AdapterResults> {
    let program = std::env::current_exe().context("the path of this program is unknown")?;
    let mut command = Command::new(program);
    command.args(["digest", "--child"]).env("VK_DRIVER_FILES", manifest).env("VK_ICD_FILENAMES", manifest);
    command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::inherit());
    let mut guarded = ChildGuard::start(&mut command).context("it cannot be started")?;
    let mut output = guarded.child().stdout.take().context("its output is not piped")?;
    // The report is shorter than a pipe holds, so the child never waits for this reader.
    match guarded.ends_before(Instant::now() + TIME_LIMIT)? {
        Some(status) if status.success() => {}
        Some(status) => bail!("it ended ({status}) without a report"),
        None => bail!("no report within {} s", TIME_LIMIT.as_secs()),
    }
    let mut text = String::new();
    output.read_to_string(&mut text).context("its report cannot be read")?;
    serde_json::from_str(&text).with_context(|| format!("its report cannot be parsed: `{}`", text.trim()))
}
