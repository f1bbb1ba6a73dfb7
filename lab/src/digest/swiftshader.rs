//! SwiftShader, the software Vulkan that comes with Chromium, under naga.
//!
//! A Vulkan loader reads which drivers to load when an instance is made, from the environment. So this program runs itself once
//! more with that variable set.

use crate::digest::child::Guarded;
use crate::digest::report::Backend;
use anyhow::{Context, Result, bail};
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// Folders in which browsers keep it.
const FOLDERS: [&str; 8] = [
    "/usr/lib/chromium",
    "/usr/lib/chromium-browser",
    "/usr/lib64/chromium-browser",
    "/opt/google/chrome",
    "/opt/chromium",
    "/usr/share/vulkan/icd.d",
    "/usr/local/share/vulkan/icd.d",
    "/Applications/Google Chrome.app/Contents/Frameworks",
];
const MANIFEST: &str = "vk_swiftshader_icd.json";

/// A million probes take a few seconds.
const TIME_LIMIT: Duration = Duration::from_secs(180);

/// Its manifest, where one is installed.
#[must_use]
pub fn manifest() -> Option<PathBuf> {
    FOLDERS.iter().map(|folder| Path::new(folder).join(MANIFEST)).find(|path| path.exists())
}

/// The backends that a child of this program finds with that manifest.
///
/// # Errors
/// The child cannot be started, fails, or takes too long.
pub fn backends(manifest: &Path) -> Result<Vec<Backend>> {
    let program = std::env::current_exe().context("this program cannot find itself")?;
    let mut command = Command::new(program);
    command.args(["digest", "--child"]).env("VK_DRIVER_FILES", manifest).env("VK_ICD_FILENAMES", manifest);
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::inherit()).spawn();
    let mut child = Guarded(child.context("it cannot be started")?);
    let mut output = child.0.stdout.take().context("its output is not piped")?;
    // The report is shorter than a pipe holds, so the child never waits for this reader.
    if !child.ends_before(Instant::now() + TIME_LIMIT)? {
        bail!("no answer within {} s", TIME_LIMIT.as_secs());
    }
    let mut text = String::new();
    output.read_to_string(&mut text).context("its report cannot be read")?;
    serde_json::from_str(&text).with_context(|| format!("its report cannot be understood: `{}`", text.trim()))
}
