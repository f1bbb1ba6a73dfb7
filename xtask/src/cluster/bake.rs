//! A region that is baked in parts, one of them killed: its objects, and what a server makes of it.

use super::chunks::{self, Truth};
use super::http::metric;
use super::objects::files;
use crate::process;
use crate::server::Server;
use anyhow::{Context, Result, ensure};
use bars::Bar;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread::sleep;
use std::time::{Duration, Instant};

/// The region: 16 packs of 16 x 16 chunks of level 2, each chunk 512 m wide.
const AREA: &str = "--area=-16384,-16384,16384,16384";
const LEVEL: u8 = 2;
const SIDE: i32 = 64;

/// Numbers of parts.
const PARTS: [u32; 3] = [1, 2, 7];

/// Time for the first packs of the part that is killed.
const FIRST_PACK_WITHIN: Duration = Duration::from_secs(120);

/// Generated chunks of a replica.
const GENERATED: &str = "tombolo_generation_jobs_total{outcome=\"completed\"}";

/// Contents by path under the folder of the store.
type Contents = BTreeMap<String, Vec<u8>>;

/// The rows.
///
/// # Errors
/// A bake fails.
pub fn rows() -> Result<Vec<Bar>> {
    let folder = super::folder("bake")?;
    let mut rows = Vec::new();
    // The control of the comparison: one part, which nothing interrupts.
    let store = folder.join("whole");
    std::fs::create_dir_all(&store)?;
    process::run(bake(&store, 0, 1))?;
    let whole = contents(&store)?;
    rows.extend([
        Bar::reported("bake: packs of 4,096 chunks", Some(packs(&whole) as f64), ""),
        Bar::reported(
            "bake: bytes of a chunk in them, mean",
            Some(whole.values().map(Vec::len).sum::<usize>() as f64 / 4096.0),
            "B",
        ),
    ]);
    for parts in PARTS {
        let store = folder.join(parts.to_string());
        let killed_with = kill_one(&store, parts)?;
        for part in 0..parts {
            process::run(bake(&store, part, parts))?;
        }
        let contents = contents(&store)?;
        rows.push(Bar::some(
            format!("bake in {parts}: packs that the killed part had still to write"),
            unwritten(packs(&contents), parts, killed_with),
        ));
        let differing = whole.iter().filter(|(path, bytes)| contents.get(*path) != Some(*bytes)).count()
            + contents.keys().filter(|path| !whole.contains_key(*path)).count();
        rows.push(Bar::none(
            format!("bake in {parts}, a part killed: objects that differ from those of a whole bake"),
            Some(differing as f64),
        ));
    }
    rows.extend(served(&folder.join("7"))?);
    // Results of a build may stay: a failed removal is harmless.
    let _ = std::fs::remove_dir_all(&folder);
    Ok(rows)
}

/// Kills the first part once it has written a pack. Returns the packs that exist then; none if the
/// part had ended, or all of its packs were there, before it was killed.
fn kill_one(store: &Path, parts: u32) -> Result<Option<usize>> {
    std::fs::create_dir_all(store)?;
    let mut bake = bake(store, 0, parts);
    // The first of 7 parts has 3 packs: many threads could write all of them between two looks.
    let mut child = bake.args(["--threads", "1"]).spawn().context("cannot start tombolo-server bake")?;
    if !kill_after(&mut child, |child| wait_for_pack(store, child))? {
        return Ok(None);
    }
    let contents = contents(store)?;
    let has_region = contents.keys().any(|path| path.contains("regions/"));
    Ok((!has_region).then(|| packs(&contents)))
}

/// Waits until the store has a pack, or the child has ended.
fn wait_for_pack(store: &Path, child: &mut Child) -> Result<()> {
    let deadline = Instant::now() + FIRST_PACK_WITHIN;
    // By names alone: to read all objects takes longer than to write the next pack.
    while !files(store)?.iter().any(|path| path.ends_with("pack")) {
        if !matches!(child.try_wait(), Ok(None)) {
            return Ok(());
        }
        ensure!(Instant::now() < deadline, "the bake wrote no pack within {FIRST_PACK_WITHIN:?}");
        sleep(Duration::from_millis(1));
    }
    Ok(())
}

/// Kills a child after a wait, also after one that failed. Returns whether a signal ended the
/// child: not if it had ended before.
fn kill_after(child: &mut Child, wait: impl FnOnce(&mut Child) -> Result<()>) -> Result<bool> {
    let waited = wait(child);
    child.kill().context("cannot kill the bake")?;
    let status = child.wait().context("cannot wait for the bake")?;
    waited.map(|()| is_by_signal(status))
}

#[cfg(unix)]
fn is_by_signal(status: ExitStatus) -> bool {
    use std::os::unix::process::ExitStatusExt;
    status.signal().is_some()
}

/// Other systems do not report it.
#[cfg(not(unix))]
fn is_by_signal(_: ExitStatus) -> bool {
    false
}

/// Packs that the first part had still to write when it was killed, if it was. Of N parts it has
/// every N-th pack, the first one included.
fn unwritten(all: usize, parts: u32, killed_with: Option<usize>) -> Option<f64> {
    let owned = all.div_ceil(parts as usize);
    killed_with.map(|written| owned as f64 - written as f64)
}

fn bake(store: &Path, part: u32, parts: u32) -> Command {
    let mut bake = process::command(process::program("tombolo-server"));
    bake.args(["bake", "--levels", &LEVEL.to_string(), AREA])
        .args(["--world-seed", &super::WORLD_SEED.to_string()])
        .args(["--part", &format!("{part}/{parts}")])
        .arg("--store")
        .arg(store)
        .stdin(Stdio::null())
        .stdout(Stdio::null())
        .stderr(Stdio::null());
    bake
}

fn packs(contents: &Contents) -> usize {
    contents.keys().filter(|path| path.ends_with("/pack")).count()
}

/// All objects. One that is being written has a name of its own and may vanish.
fn contents(store: &Path) -> Result<Contents> {
    let read = |path: std::path::PathBuf| {
        let name = path.strip_prefix(store).ok()?.to_str()?.to_owned();
        let is_object = name.ends_with("/pack") || name.contains("/regions/");
        Some((name, std::fs::read(&path).ok()?)).filter(|_| is_object)
    };
    Ok(files(store)?.into_iter().filter_map(read).collect())
}

/// Every chunk of the region from a replica that has it in its store, and from one that has not.
fn served(store: &Path) -> Result<Vec<Bar>> {
    let paths = chunks::square(LEVEL, SIDE);
    let mut truth = Truth::new();
    let alone = Server::start(super::WORLD_SEED)?;
    chunks::ask(alone.address(), &paths, &mut truth, || Ok(()))?;
    let made_alone = metric(alone.address(), GENERATED)?;
    drop(alone);
    let settings =
        [("TOMBOLO_STORE", store.display().to_string()), ("TOMBOLO_STORE_WAIT_MS", "2000".to_owned())];
    let replica = Server::start_with(super::WORLD_SEED, &settings)?;
    // The replica looks for regions when it starts.
    sleep(Duration::from_secs(1));
    let asked = chunks::ask(replica.address(), &paths, &mut truth, || Ok(()))?;
    let made = metric(replica.address(), GENERATED)?;
    Ok(vec![
        Bar::none("baked region: wrong chunks or none, of 4,096", Some((asked.wrong + asked.failed) as f64)),
        Bar::none("baked region: chunks that the server generated, of 4,096", Some(made)),
        Bar::at_least("control: the same without the store", Some(made_alone), "", 4096.0),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_that_had_written_all_of_its_packs_or_was_not_killed_is_a_miss() {
        let is_missed = |parts, killed_with| Bar::some("x", unwritten(16, parts, killed_with)).is_missed();
        for (parts, owned) in [(1, 16), (2, 8), (7, 3)] {
            assert!(!is_missed(parts, Some(1)) && !is_missed(parts, Some(owned - 1)), "{parts}");
            assert!(is_missed(parts, Some(owned)) && is_missed(parts, Some(16)), "{parts}");
            assert!(is_missed(parts, None), "{parts}");
        }
    }

    #[cfg(unix)]
    #[test]
    fn a_signal_ends_a_child_unless_it_has_ended_and_also_after_a_failed_wait() {
        let sleeping = || Command::new("sleep").arg("600").spawn().unwrap();
        assert!(kill_after(&mut sleeping(), |_| Ok(())).unwrap());
        let end = |child: &mut Child| child.wait().map(drop).context("sh");
        let mut ended = Command::new("sh").args(["-c", "exit 3"]).spawn().unwrap();
        assert!(!kill_after(&mut ended, end).unwrap());
        let mut child = sleeping();
        assert!(kill_after(&mut child, |_| anyhow::bail!("no pack")).is_err());
        assert!(matches!(child.try_wait(), Ok(Some(_))));
    }
}
