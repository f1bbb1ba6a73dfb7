//! The poses: `docs/gallery/poses.txt`, one a line: name, title and options of the viewer, between
//! bars. A test draws some of them from the same file.

use anyhow::{Context, Result, ensure};

const TEXT: &str = include_str!("../../../docs/gallery/poses.txt");

/// A pose.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Pose {
    /// Name of its files.
    pub name: &'static str,
    /// Description of the view.
    pub title: &'static str,
    /// Options of the viewer.
    pub options: &'static str,
}

impl Pose {
    /// The options one by one.
    pub fn words(&self) -> impl Iterator<Item = &'static str> {
        self.options.split_whitespace()
    }

    /// Name of its picture.
    pub fn file(&self) -> String {
        format!("{}.png", self.name)
    }

    /// Whether its camera is found by the viewer.
    pub fn has_place(&self) -> bool {
        self.words().any(|word| word == "--place")
    }
}

/// All poses in the order of the page.
///
/// # Errors
/// A line is no pose, or two have the same name.
pub fn all() -> Result<Vec<Pose>> {
    let lines = TEXT.lines().filter(|line| !line.is_empty() && !line.starts_with('#'));
    let mut poses: Vec<Pose> = Vec::new();
    for line in lines {
        let mut parts = line.split('|').map(str::trim);
        let pose = match [parts.next(), parts.next(), parts.next(), parts.next()] {
            [Some(name), Some(title), Some(options), None] => Some(Pose { name, title, options }),
            _ => None,
        };
        let pose = pose.with_context(|| format!("gallery: expected NAME | TITLE | OPTIONS, found {line}"))?;
        ensure!(poses.iter().all(|other| other.name != pose.name), "gallery: two poses named {}", pose.name);
        poses.push(pose);
    }
    Ok(poses)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn there_are_24_poses_and_names_are_those_of_files() {
        let poses = all().unwrap();
        assert!(poses.len() >= 24, "{}", poses.len());
        for pose in &poses {
            let is_plain = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
            assert!(!pose.name.is_empty() && pose.name.chars().all(is_plain), "{}", pose.name);
            assert!(!pose.title.is_empty());
            for option in ["--shot", "--size", "--connect"] {
                assert!(pose.words().all(|word| !word.starts_with(option)), "{}: {option}", pose.name);
            }
        }
        assert_eq!(poses.iter().filter(|pose| pose.has_place()).count(), 8, "each place once");
    }
}
