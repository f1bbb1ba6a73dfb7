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
    /// As [`Extent::Headless`], and what `ci` looks with: a browser, Node, compilers. What cannot
    /// be installed of these is mentioned; `ci` lists the checks that it skips for it.
    Checks,
}

/// What needs a thing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Purpose {
    Pictures,
    Windows,
    Checks,
}

/// One thing that must be present, and the Debian package that brings it.
#[derive(Clone, Copy, Debug)]
struct Need {
    package: &'static str,
    sign: Sign,
    purpose: Purpose,
}

/// How its presence shows.
#[derive(Clone, Copy, Debug)]
enum Sign {
    /// A shared library in the linker's cache.
    Library(&'static str),
    /// A driver manifest in one of the loader's folders.
    VulkanDriver,
    /// SwiftShader's manifest, which comes with a browser.
    SwiftShader,
    /// A program on `PATH`.
    Program(&'static str),
    /// The library that bindings to C++ are generated with.
    Libclang,
}

/// Loaded at run time by the GPU and window crates, so the linker never asks for them.
const NEEDS: [Need; 23] = [
    Need { package: "libvulkan1", sign: Sign::Library("libvulkan.so.1"), purpose: Purpose::Pictures },
    Need { package: "mesa-vulkan-drivers", sign: Sign::VulkanDriver, purpose: Purpose::Pictures },
    check("chromium", Sign::SwiftShader),
    check("xvfb", Sign::Program("Xvfb")),
    check("libegl1", Sign::Library("libEGL.so.1")),
    check("nodejs", Sign::Program("node")),
    check("clang-19", Sign::Program("clang-19")),
    check("cmake", Sign::Program("cmake")),
    check("make", Sign::Program("make")),
    check("g++", Sign::Program("g++")),
    check("libclang-19-dev", Sign::Libclang),
    check("nginx-light", Sign::Program("nginx")),
    check("prometheus", Sign::Program("promtool")),
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
    Need { package, sign: Sign::Library(library), purpose: Purpose::Windows }
}

const fn check(package: &'static str, sign: Sign) -> Need {
    Need { package, sign, purpose: Purpose::Checks }
}

impl Need {
    /// Whether a run cannot do without it.
    fn is_vital(&self, extent: Extent) -> bool {
        match self.purpose {
            Purpose::Pictures => true,
            Purpose::Windows => extent == Extent::Everything,
            Purpose::Checks => false,
        }
    }
}

/// Where a Vulkan loader looks for drivers; the last is that of NixOS.
const DRIVER_FOLDERS: [&str; 4] = [
    "/usr/share/vulkan/icd.d",
    "/etc/vulkan/icd.d",
    "/usr/local/share/vulkan/icd.d",
    "/run/opengl-driver/share/vulkan/icd.d",
];

/// Makes sure that everything is there.
///
/// # Errors
/// Something that this run needs is missing and could not be installed.
pub fn run(extent: Extent) -> Result<()> {
    if !cfg!(target_os = "linux") {
        println!("setup: nothing to install on this system");
        return Ok(());
    }
    if linker_cache().is_none() {
        println!("setup: which libraries are missing is not known: `/sbin/ldconfig -p` lists none");
    }
    install(extent, |need| need.purpose != Purpose::Checks)?;
    if extent == Extent::Checks {
        install(extent, |need| need.purpose == Purpose::Checks)?;
    }
    Ok(())
}

/// Installs what is missing of some needs.
fn install(extent: Extent, is_wanted: fn(&Need) -> bool) -> Result<()> {
    let missing = missing(is_wanted);
    if missing.is_empty() {
        println!("setup: everything is there");
        return Ok(());
    }
    let names: Vec<_> = missing.iter().map(|need| need.package).collect();
    let packages = names.join(" ");
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
    match install_with(apt, &names) {
        Ok(refused) => judge(extent, &self::missing(is_wanted), &refused),
        Err(why) if is_vital(&missing, extent) => Err(why),
        Err(why) => mention(&format!("{why:#}; missing: {packages}")),
    }
}

/// Installs packages by command lines of apt-get and returns those that it refuses. All at once;
/// one by one where that fails, since one name that a system does not know keeps all others away.
///
/// # Errors
/// The lists of packages cannot be read again.
fn install_with(apt: impl Fn(&str) -> Result<()>, packages: &[&'static str]) -> Result<Vec<&'static str>> {
    apt("update --quiet")?;
    let install = |what: &str| apt(&format!("install --quiet --yes --no-install-recommends {what}"));
    if install(&packages.join(" ")).is_ok() {
        return Ok(Vec::new());
    }
    Ok(packages.iter().copied().filter(|package| install(package).is_err()).collect())
}

/// Whether a run can do without what is still missing after an installation.
fn judge(extent: Extent, still: &[Need], refused: &[&str]) -> Result<()> {
    if let Some(need) = still.iter().find(|need| need.is_vital(extent)) {
        let is_refused = refused.contains(&need.package);
        let why = if is_refused { "could not be installed" } else { "was installed and is still not found" };
        bail!("setup: {} {why} ({:?})", need.package, need.sign);
    }
    if refused.is_empty() {
        return Ok(());
    }
    mention(&format!("apt-get could not install {}", refused.join(" ")))
}

/// Whether a Vulkan driver is installed, a software one included.
pub fn has_vulkan_driver() -> bool {
    is_present(Sign::VulkanDriver, "")
}

/// Whether EGL is installed, which OpenGL without a window needs.
pub fn has_egl() -> bool {
    is_present(Sign::Library("libEGL.so.1"), &linker_cache().unwrap_or_default())
}

/// Whether SwiftShader is installed.
pub fn has_swiftshader() -> bool {
    is_present(Sign::SwiftShader, "")
}

/// Whether libclang is installed.
pub fn has_libclang() -> bool {
    is_present(Sign::Libclang, "")
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
    println!("setup: not everything will work yet; {message}");
    Ok(())
}

fn is_vital(missing: &[Need], extent: Extent) -> bool {
    missing.iter().any(|need| need.is_vital(extent))
}

fn missing(is_wanted: fn(&Need) -> bool) -> Vec<Need> {
    let cache = linker_cache();
    NEEDS.into_iter().filter(|need| is_wanted(need) && is_missing(need.sign, cache.as_deref())).collect()
}

/// Whether a thing is known to be missing; of libraries nothing is known without the linker's list.
fn is_missing(sign: Sign, linker_cache: Option<&str>) -> bool {
    match (sign, linker_cache) {
        (Sign::Library(_), None) => false,
        (sign, cache) => !is_present(sign, cache.unwrap_or_default()),
    }
}

/// The linker's list of libraries; none where the system has no such list, as NixOS and Alpine.
fn linker_cache() -> Option<String> {
    // Not always on PATH.
    let mut ldconfig = process::command("/sbin/ldconfig");
    ldconfig.arg("-p");
    process::output(ldconfig).ok().filter(|list| has_libraries(list))
}

fn has_libraries(list: &str) -> bool {
    list.lines().any(|line| line.contains(" => "))
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
        Sign::SwiftShader => installed_browser::swiftshader_manifest().is_some(),
        Sign::Program(name) => {
            let path = std::env::var_os("PATH").unwrap_or_default();
            std::env::split_paths(&path).any(|folder| folder.join(name).is_file())
        }
        // Debian keeps each version of LLVM in a folder of its own.
        Sign::Libclang => {
            let versions = std::fs::read_dir("/usr/lib").into_iter().flatten().flatten();
            std::env::var_os("LIBCLANG_PATH").is_some()
                || versions.into_iter().any(|entry| {
                    let lib = entry.path().join("lib");
                    entry.file_name().to_string_lossy().starts_with("llvm-")
                        && ["libclang.so", "libclang.so.1"].iter().any(|name| lib.join(name).exists())
                })
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
    if process::interrupted() {
        bail!("interrupted");
    }
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
        assert!(!is_vital(&of("libxi6"), Extent::Checks));
        assert!(is_vital(&of("libvulkan1"), Extent::Checks));
    }

    #[test]
    fn a_check_without_its_tool_is_skipped_by_ci_and_stops_no_setup() {
        let checks: Vec<_> = NEEDS.into_iter().filter(|need| need.purpose == Purpose::Checks).collect();
        assert!(!checks.is_empty() && !is_vital(&checks, Extent::Checks));
    }

    #[test]
    fn without_the_list_of_the_linker_no_library_is_known_to_be_missing() {
        let (library, program) = (Sign::Library("libX11.so.6"), Sign::Program("no-such-program"));
        assert!(is_missing(library, Some("")) && !is_missing(library, None));
        assert!(is_missing(program, Some("")) && is_missing(program, None));
        assert!(has_libraries("1 libs found\n\tlibXi.so.6 (libc6,x86-64) => /lib/libXi.so.6\n"));
        assert!(!has_libraries("") && !has_libraries("0 libs found in cache `/etc/ld.so.cache'\n"));
    }

    #[test]
    fn a_package_that_the_system_does_not_know_keeps_no_other_away() {
        let with = |unknown: &'static str| {
            let lines = std::cell::RefCell::new(Vec::new());
            let apt = |line: &str| {
                lines.borrow_mut().push(line.rsplit("recommends ").next().unwrap().to_owned());
                if line.split(' ').any(|word| word == unknown) { bail!("unknown") } else { Ok(()) }
            };
            let refused = install_with(apt, &["a", "b", "c"]).ok();
            (refused, lines.into_inner())
        };
        assert_eq!(with("no"), (Some(vec![]), ["update --quiet", "a b c"].map(String::from).into()));
        let (refused, lines) = with("b");
        assert_eq!(
            (refused, &lines[1..]),
            (Some(vec!["b"]), &["a b c", "a", "b", "c"].map(String::from)[..])
        );
        // Without a network nothing else is tried.
        assert_eq!(with("update"), (None, vec!["update --quiet".into()]));
    }

    #[test]
    fn what_is_still_missing_stops_only_a_run_that_needs_it() {
        let of = |package: &str| NEEDS.into_iter().filter(|need| need.package == package).collect::<Vec<_>>();
        let fault = |extent, package: &str, refused: &[&str]| {
            judge(extent, &of(package), refused).err().map(|why| why.to_string()).unwrap_or_default()
        };
        assert!(fault(Extent::Headless, "libvulkan1", &["libvulkan1"]).contains("could not be installed"));
        assert!(fault(Extent::Headless, "libvulkan1", &[]).contains("still not found"));
        assert_eq!(fault(Extent::Headless, "libxi6", &["libxi6"]), "");
        assert_eq!(fault(Extent::Checks, "cmake", &["cmake"]), "");
    }
}
