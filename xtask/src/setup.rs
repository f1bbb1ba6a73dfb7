//! `setup`: installs what the programs need and the system lacks.
//!
//! A Rust toolchain with its linker must be there already, or this program could not have been
//! built. Looks first and touches nothing that is present; installs through apt-get when root, else
//! names the one command to run.

use crate::process;
use anyhow::{Context, Result, bail};
use std::path::Path;

/// How much this run is going to use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// Pictures without a window: a Vulkan loader and a driver. Lacking window libraries are only
    /// mentioned.
    Headless,
    /// Windows too.
    Everything,
}

/// One thing that must be present, and the Debian package that brings it.
#[derive(Clone, Copy, Debug)]
struct Need {
    package: &'static str,
    sign: Sign,
    /// Whether only windows need it.
    window: bool,
}

/// How its presence shows.
#[derive(Clone, Copy, Debug)]
enum Sign {
    /// A shared library in the linker's cache.
    Library(&'static str),
    /// A driver manifest in one of the loader's folders.
    VulkanDriver,
}

/// Loaded at run time by the GPU and window crates, so the linker never asks for them.
const NEEDS: [Need; 12] = [
    Need { package: "libvulkan1", sign: Sign::Library("libvulkan.so.1"), window: false },
    Need { package: "mesa-vulkan-drivers", sign: Sign::VulkanDriver, window: false },
    window("libx11-6", "libX11.so.6"),
    window("libx11-xcb1", "libX11-xcb.so.1"),
    window("libxcb1", "libxcb.so.1"),
    window("libxcursor1", "libXcursor.so.1"),
    window("libxi6", "libXi.so.6"),
    window("libxrandr2", "libXrandr.so.2"),
    window("libxkbcommon0", "libxkbcommon.so.0"),
    window("libxkbcommon-x11-0", "libxkbcommon-x11.so.0"),
    window("libwayland-client0", "libwayland-client.so.0"),
    window("libwayland-cursor0", "libwayland-cursor.so.0"),
];

const fn window(package: &'static str, library: &'static str) -> Need {
    Need { package, sign: Sign::Library(library), window: true }
}

/// Where a Vulkan loader looks for drivers.
const DRIVER_FOLDERS: [&str; 3] =
    ["/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d"];

/// Makes sure that everything is there.
///
/// # Errors
/// Something that this run needs is missing and could not be installed.
pub fn run(extent: Extent) -> Result<()> {
    if !cfg!(target_os = "linux") {
        println!("setup: nothing to install on this system");
        return Ok(());
    }
    let missing = missing();
    if missing.is_empty() {
        println!("setup: everything is there");
        return Ok(());
    }
    let packages: Vec<_> = missing.iter().map(|need| need.package).collect();
    let packages = packages.join(" ");
    if !Path::new("/usr/bin/apt-get").exists() {
        let message = format!("missing: what Debian calls {packages}; install it with your package manager");
        return if is_vital(&missing, extent) { bail!("setup: {message}") } else { mention(&message) };
    }
    if !is_root() {
        let message = format!("run: sudo apt-get install --no-install-recommends {packages}");
        return if is_vital(&missing, extent) {
            bail!("setup: libraries are missing; {message}")
        } else {
            mention(&message)
        };
    }
    println!("setup: installing {packages}");
    apt("update --quiet")?;
    apt(&format!("install --quiet --yes --no-install-recommends {packages}"))?;
    let still = self::missing();
    match still.first() {
        Some(need) if is_vital(&still, extent) => {
            bail!("setup: {} was installed and is still not found ({:?})", need.package, need.sign)
        }
        _ => Ok(()),
    }
}

/// Makes sure that a cargo subcommand is there; `probe` is a command line that succeeds with it.
///
/// # Errors
/// It is missing and cannot be installed.
pub fn cargo_tool(probe: &str, package: &str, version: &str) -> Result<()> {
    if process::succeeds(process::cargo(probe)) {
        return Ok(());
    }
    println!("setup: installing {package} {version}");
    process::run(process::cargo(&format!("install --locked {package}@{version}")))
        .with_context(|| format!("setup: {package} is missing; install it and run this again"))
}

fn mention(message: &str) -> Result<()> {
    println!("setup: windows will not open yet; {message}");
    Ok(())
}

fn is_vital(missing: &[Need], extent: Extent) -> bool {
    extent == Extent::Everything || missing.iter().any(|need| !need.window)
}

fn missing() -> Vec<Need> {
    // Not always on PATH; without its output every library counts as missing and apt decides.
    let cache = process::output({
        let mut ldconfig = process::command("/sbin/ldconfig");
        ldconfig.arg("-p");
        ldconfig
    })
    .unwrap_or_default();
    NEEDS.into_iter().filter(|need| !is_present(need.sign, &cache)).collect()
}

fn is_present(sign: Sign, linker_cache: &str) -> bool {
    match sign {
        Sign::Library(library) => {
            linker_cache.lines().any(|line| line.split_whitespace().next() == Some(library))
        }
        Sign::VulkanDriver => {
            let named = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"].map(std::env::var_os).into_iter().flatten();
            named.into_iter().any(|list| !list.is_empty()) || DRIVER_FOLDERS.into_iter().any(has_manifest)
        }
    }
}

fn has_manifest(folder: &str) -> bool {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.into_iter().any(|entry| entry.path().extension().is_some_and(|extension| extension == "json"))
}

fn is_root() -> bool {
    let mut id = process::command("id");
    id.arg("-u");
    process::output(id).is_ok_and(|id| id.trim() == "0")
}

fn apt(line: &str) -> Result<()> {
    let mut apt = process::command("apt-get");
    apt.args(line.split_whitespace()).env("DEBIAN_FRONTEND", "noninteractive");
    process::run(apt).context("setup: apt-get could not install; is the network there?")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_library_is_present_only_under_its_exact_name() {
        let cache =
            "12 libs found\n\tlibX11.so.6 (libc6,x86-64) => /lib/libX11.so.6\n\tlibXi.so (libc6) => /x\n";
        assert!(is_present(Sign::Library("libX11.so.6"), cache));
        assert!(!is_present(Sign::Library("libXi.so.6"), cache));
        assert!(!is_present(Sign::Library("libX11.so.6"), ""));
    }

    #[test]
    fn lacking_window_libraries_stop_only_who_opens_windows() {
        let of = |package| NEEDS.into_iter().filter(|need| need.package == package).collect::<Vec<_>>();
        assert!(!is_vital(&of("libxi6"), Extent::Headless));
        assert!(is_vital(&of("libxi6"), Extent::Everything));
        assert!(is_vital(&of("libvulkan1"), Extent::Headless));
    }
}
