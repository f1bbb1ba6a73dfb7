//! Where Chromium and its SwiftShader are installed.

#![forbid(unsafe_code)]

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// Names under which Chromium is installed.
const PROGRAMS: [&str; 5] =
    ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome"];

/// Folders in which browsers install SwiftShader.
const SWIFTSHADER_FOLDERS: [&str; 8] = [
    "/usr/lib/chromium",
    "/usr/lib/chromium-browser",
    "/usr/lib64/chromium-browser",
    "/opt/google/chrome",
    "/opt/chromium",
    "/usr/share/vulkan/icd.d",
    "/usr/local/share/vulkan/icd.d",
    "/Applications/Google Chrome.app/Contents/Frameworks",
];

/// SwiftShader's manifest for a Vulkan loader.
const SWIFTSHADER_MANIFEST: &str = "vk_swiftshader_icd.json";

/// Chromium on `PATH`, if it is installed.
#[must_use]
pub fn chromium() -> Option<PathBuf> {
    chromium_on(&std::env::var_os("PATH")?)
}

/// Chromium on a list of folders in the form of `PATH`: under the first name that any of them has.
#[must_use]
pub fn chromium_on(path: &OsStr) -> Option<PathBuf> {
    let folders: Vec<PathBuf> = std::env::split_paths(path).collect();
    let in_folders = |name| folders.iter().map(move |folder| folder.join(name));
    PROGRAMS.iter().flat_map(in_folders).find(|program| program.is_file())
}

/// The manifest of SwiftShader, the software Vulkan driver of browsers, if it is installed.
#[must_use]
pub fn swiftshader_manifest() -> Option<PathBuf> {
    let manifests = SWIFTSHADER_FOLDERS.iter().map(|folder| Path::new(folder).join(SWIFTSHADER_MANIFEST));
    manifests.into_iter().find(|manifest| manifest.is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_name_that_any_folder_has_is_found() {
        let folder = std::env::temp_dir().join(format!("tombolo-browser-{}", std::process::id()));
        let [one, two] = ["one", "two"].map(|name| folder.join(name));
        for file in [one.join("chrome"), two.join("google-chrome")] {
            std::fs::create_dir_all(file.parent().unwrap()).unwrap();
            std::fs::write(file, "").unwrap();
        }
        let on = |folders: &[&PathBuf]| chromium_on(&std::env::join_paths(folders).unwrap());
        assert_eq!(on(&[&one, &two]), Some(two.join("google-chrome")));
        assert_eq!(on(&[&one]), Some(one.join("chrome")));
        assert_eq!(on(&[&folder]), None, "a folder without a browser");
        std::fs::remove_dir_all(folder).unwrap();
    }
}
