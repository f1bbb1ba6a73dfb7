//! A soak test: clients fly for hours, and every minute a replica or the store fails. The memory of
//! the replica that stays must not grow, and no chunk may be wrong.

use super::Cluster;
use super::capacity::resident_kib;
use super::failure::{gap, without_another, wrong};
use super::http::metric;
use super::load::Load;
use super::objects::{self, Objects};
use super::store::{INVALID, LATE_OR_FAILED, SLOW, compose_wait};
use crate::process;
use anyhow::{Result, bail};
use bars::Bar;
use bars::figures::at;
use std::thread::sleep;
use std::time::{Duration, Instant};

/// Length of a whole test, and the part of it in which caches and pools reach their size.
pub const LENGTH: Duration = Duration::from_secs(2 * 3600);
const WARM_UP: Duration = Duration::from_secs(1800);

const CLIENTS: u32 = 100;

/// The first replica never fails; each of the others does in turn.
const REPLICAS: u8 = 3;

/// A cache that is full long before memory is judged.
const CACHE: (&str, &str) = ("TOMBOLO_CACHE_MB", "64");

/// Time from the start of a fault to that of the next, and how long one lasts.
const INTERVAL: Duration = Duration::from_secs(60);
const LASTS: Duration = Duration::from_secs(20);

/// Time between two samples of the memory.
const SAMPLE_INTERVAL: Duration = Duration::from_secs(5);

/// What fails.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    /// SIGKILL of a replica.
    Killed,
    /// The store accepts connections and does not answer.
    StoreHangs,
    /// SIGTERM of a replica.
    Terminated,
    /// The store answers 2 s later.
    StoreSlow,
    /// A byte of each object changes.
    StoreDamaged,
}

impl Fault {
    /// In the order in which they happen.
    const ALL: [Self; 5] =
        [Self::Killed, Self::StoreHangs, Self::Terminated, Self::StoreSlow, Self::StoreDamaged];

    /// The replica that ends.
    const fn replica(self) -> Option<usize> {
        match self {
            Self::Killed => Some(1),
            Self::Terminated => Some(2),
            Self::StoreHangs | Self::StoreSlow | Self::StoreDamaged => None,
        }
    }
}

/// A cluster under test.
struct Soak {
    cluster: Cluster,
    objects: Objects,
    settings: super::Settings,
    /// Seconds from the start, and memory of the first replica in MiB.
    samples: Vec<[f64; 2]>,
    faults: usize,
    /// Replicas that did not end within their time after SIGTERM.
    late_ends: usize,
}

/// The rows of a test of some length.
///
/// # Errors
/// A process does not start, or the first replica ended.
pub fn rows(length: Duration) -> Result<Vec<Bar>> {
    if let Some(reason) = objects::lacks() {
        let name = "soak: growth of the memory of a replica, wrong chunks, lost sessions";
        return Ok(vec![Bar::reported(name, None, "").not_measured_if(true, &reason)]);
    }
    let objects = Objects::start("soak", None)?;
    let mut settings = objects.settings().to_vec();
    settings.extend([compose_wait(), (CACHE.0, CACHE.1.to_owned())]);
    let cluster = Cluster::start_with(REPLICAS, &settings)?;
    let mut soak = Soak { cluster, objects, settings, samples: Vec::new(), faults: 0, late_ends: 0 };
    let load = Load::start(soak.cluster.nginx.address(), CLIENTS, length.as_secs(), &[])?;
    let started = Instant::now();
    for fault in Fault::ALL.iter().cycle() {
        let next = started + INTERVAL * (soak.faults as u32 + 1);
        if next > started + length {
            break;
        }
        soak.sample(started, next - LASTS)?;
        soak.begin(*fault)?;
        soak.sample(started, next)?;
        soak.end(*fault)?;
    }
    let survivor = soak.cluster.replicas[0].address();
    let count = |names: &[&str]| names.iter().map(|name| metric(survivor, name)).sum::<Result<f64>>();
    let (late, invalid) = (count(LATE_OR_FAILED)?, count(&[INVALID])?);
    let report = load.report()?;
    let judged: Vec<_> =
        soak.samples.iter().copied().filter(|[at_s, _]| *at_s >= WARM_UP.as_secs_f64()).collect();
    let last_mib = soak.samples.last().map(|[_, mib]| *mib);
    let minutes = started.elapsed().as_secs_f64() / 60.0;
    let is_whole = length >= LENGTH;
    Ok(vec![
        Bar::under(
            "soak: growth of the memory of the replica that stays",
            slope(&judged).filter(|_| is_whole).map(|mib_per_s| 3600.0 * mib_per_s),
            "MiB/h",
            1.0,
        )
        .with_note("resident, line of least squares from the 30th minute on; a shorter test has no figure"),
        Bar::reported("soak: its memory at the end", last_mib, "MiB"),
        Bar::reported("soak: length", Some(minutes), "min"),
        Bar::at_least("soak: faults", Some(soak.faults as f64), "", minutes - 2.0).with_note(
            "one a minute: a replica killed, the store hangs, a replica terminated, the store 2 s late, \
             every object damaged",
        ),
        Bar::none("soak: ends after SIGTERM that took too long", Some(soak.late_ends as f64)),
        wrong("soak: wrong chunks", &report),
        Bar::none("soak: lost sessions without another", without_another(&report)),
        Bar::reported("soak: gap between deliveries, longest", gap(&report, "max"), "s"),
        Bar::some("control: sessions that the faults ended", at(&report, "resume/lost")),
        Bar::some("control: reads of the store that were late or failed", Some(late)),
        Bar::some("control: damaged objects that were read", Some(invalid)),
    ])
}

impl Soak {
    /// Samples the memory until a moment.
    fn sample(&mut self, started: Instant, until: Instant) -> Result<()> {
        while Instant::now() < until {
            sleep(SAMPLE_INTERVAL.min(until.saturating_duration_since(Instant::now())));
            if process::interrupted() {
                bail!("interrupted");
            }
            let mib = resident_kib(&self.cluster.replicas[0])? / 1024.0;
            self.samples.push([started.elapsed().as_secs_f64(), mib]);
        }
        Ok(())
    }

    fn begin(&mut self, fault: Fault) -> Result<()> {
        self.faults += 1;
        match fault {
            Fault::Killed => self.cluster.replicas[1].kill(),
            Fault::Terminated => {
                self.late_ends += usize::from(self.cluster.replicas[2].terminate().is_none());
            }
            Fault::StoreHangs => self.objects.hang()?,
            Fault::StoreSlow => self.objects.slow_down(SLOW),
            Fault::StoreDamaged => _ = self.objects.damage()?,
        }
        Ok(())
    }

    fn end(&mut self, fault: Fault) -> Result<()> {
        if let Some(replica) = fault.replica() {
            let replica = &mut self.cluster.replicas[replica];
            *replica = super::replica_at(replica.address(), &self.settings)?;
        }
        match fault {
            Fault::StoreHangs => self.objects.go_on(),
            Fault::StoreSlow => {
                self.objects.slow_down(Duration::ZERO);
                Ok(())
            }
            Fault::Killed | Fault::Terminated | Fault::StoreDamaged => Ok(()),
        }
    }
}

/// Slope of the line of least squares through points; none of fewer than two abscissae.
fn slope(points: &[[f64; 2]]) -> Option<f64> {
    let mean = |axis: usize| points.iter().map(|point| point[axis]).sum::<f64>() / points.len() as f64;
    let [x, y] = [mean(0), mean(1)];
    let square: f64 = points.iter().map(|point| (point[0] - x).powi(2)).sum();
    let product: f64 = points.iter().map(|point| (point[0] - x) * (point[1] - y)).sum();
    (square > 0.0).then(|| product / square)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_leak_has_a_slope_and_noise_has_none() {
        let noise = |n: u32| if n.is_multiple_of(2) { 3.0 } else { -3.0 };
        let points = |per_s: f64| -> Vec<_> {
            (0..1000).map(|n| [f64::from(n), 100.0 + per_s * f64::from(n) + noise(n)]).collect()
        };
        assert!(slope(&points(0.0)).unwrap().abs() < 1e-3);
        assert!((slope(&points(0.01)).unwrap() - 0.01).abs() < 1e-3);
        assert_eq!((slope(&[]), slope(&[[1.0, 2.0]])), (None, None));
    }

    #[test]
    fn the_first_replica_never_ends() {
        assert!(Fault::ALL.iter().all(|fault| fault.replica() != Some(0)));
    }
}
