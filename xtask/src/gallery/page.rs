//! `docs/gallery.md`: the pictures side by side, and the command line of each.

use super::earlier::COMMIT;
use super::pose::Pose;
use super::{FOLDER, SIZE, WORLD_SEED};
use crate::process;
use anyhow::{Context, Result};
use std::fmt::Write as _;

/// Writes the page.
///
/// # Errors
/// It cannot be written.
pub fn write(poses: &[Pose]) -> Result<()> {
    let folder = process::root().join(FOLDER);
    let has = |path: String| folder.join(path).is_file();
    let is_drawn = |pose: &Pose| (has(format!("before/{}", pose.file())), has(pose.file()));
    let path = process::root().join("docs/gallery.md");
    std::fs::write(&path, text(poses, is_drawn)).with_context(|| format!("cannot write {}", path.display()))
}

fn text(poses: &[Pose], is_drawn: impl Fn(&Pose) -> (bool, bool)) -> String {
    let mut text = format!(
        "# Gallery\n\n\
         Fixed poses of world {WORLD_SEED}, left as commit {COMMIT} draws them, right as they are now.\n\
         `cargo xtask gallery` writes this page and the right column, `cargo xtask gallery --before` the\n\
         left one; the poses are in [poses.txt](gallery/poses.txt). Each picture is `tombolo-view\n\
         --connect URL --size {SIZE} --shot FILE.png` with the options below it. The earlier viewer is\n\
         run without `--quality`, and with `--camera` in place of `--place`. Pictures are reduced to 256\n\
         colours afterwards: bands in the sky come from that, not from the viewer.\n"
    );
    for pose in poses {
        let cell = |is_there: bool, path: String| {
            if is_there { format!("![{}]({path})", pose.title) } else { "not drawn".to_owned() }
        };
        let (before, after) = is_drawn(pose);
        let before = cell(before, format!("gallery/before/{}", pose.file()));
        let after = cell(after, format!("gallery/{}", pose.file()));
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "\n## {}\n\n| before | now |\n| --- | --- |\n| {before} | {after} |\n\n",
            pose.title
        );
        let _ = writeln!(text, "    tombolo-view {}", pose.options);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_pose_has_both_pictures_and_its_options() {
        let pose = Pose { name: "bay", title: "A bay", options: "--fov 30" };
        let page = text(std::slice::from_ref(&pose), |_| (true, true));
        for part in
            ["](gallery/before/bay.png)", "](gallery/bay.png)", "    tombolo-view --fov 30\n", "## A bay"]
        {
            assert!(page.contains(part), "{part}: {page}");
        }
        assert!(text(&[pose], |_| (false, true)).contains("not drawn"));
    }
}
