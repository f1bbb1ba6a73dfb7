//! The clients, the faults, and the clock of one simulation.

use crate::client::Client;
use crate::connection::{Actions, Last, drive};
use crate::link::{ClientEnd, Link};
use crate::plant::Plant;
use crate::received::Received;
use crate::server::Server;
use crate::worker::{Outcome, Pace, planted};
use std::cell::{Cell, RefCell};
use std::collections::BTreeMap;
use std::rc::Rc;
use std::time::Duration;
use test_support::Random;
use tokio::runtime;
use tokio::task::{LocalSet, spawn_local};
use tokio::time::{Instant, sleep, sleep_until, timeout_at};

/// Clients of a simulation.
const CLIENTS: u32 = 4;

/// Time of random actions and faults.
const FAULTS: Duration = Duration::from_secs(12);

/// Time after them until every view is complete and every session that lost its client has ended:
/// a silent one by the keep-alive, after 60 to 80 s.
const REST: Duration = Duration::from_secs(100);

/// What all tasks of a simulation share.
struct World {
    plant: Plant,
    /// Faults end then.
    faults_end: Instant,
    server: RefCell<Server>,
    /// The last connection of each client.
    links: RefCell<BTreeMap<u32, Link>>,
    /// Connections that clients have lost and servers have not.
    silent: RefCell<Vec<Link>>,
    speed: Rc<Speed>,
}

/// How long chunks take, and how they end.
struct Speed {
    random: RefCell<Random>,
    slow_until: Cell<Instant>,
    failing_until: Cell<Instant>,
}

impl Speed {
    /// Of the next chunk; none if it never ends.
    fn next(&self, plant: Plant) -> Pace {
        let (random, now) = (&mut *self.random.borrow_mut(), Instant::now());
        let slowness = if now < self.slow_until.get() { 20 } else { 1 };
        let takes = Duration::from_millis(random.ms(1..8) * slowness);
        let fails = now < self.failing_until.get() && random.percent(30);
        let outcome = if fails { Some(Outcome::Panic) } else { planted(plant, random.percent(2)) };
        outcome.map(|outcome| (takes, outcome))
    }
}

/// Runs the simulation of a seed. Returns what the clients received.
///
/// # Errors
/// A violated invariant.
pub fn run(seed: u64, plant: Plant) -> Result<Received, String> {
    // The clock advances when all tasks wait: a generation thread works while one of them runs.
    let mut builder = runtime::Builder::new_current_thread();
    let runtime = builder.enable_time().start_paused(true).build().expect("a runtime");
    LocalSet::new().block_on(&runtime, simulated(seed, plant))
}

async fn simulated(seed: u64, plant: Plant) -> Result<Received, String> {
    let mut random = Random(seed);
    let mut branch = || Random(random.bits());
    let start = Instant::now();
    let speed = Rc::new(Speed {
        random: RefCell::new(branch()),
        slow_until: Cell::new(start),
        failing_until: Cell::new(start),
    });
    let server = started(plant, &speed);
    let world = Rc::new(World {
        plant,
        faults_end: start + FAULTS,
        server: RefCell::new(server),
        links: RefCell::default(),
        silent: RefCell::default(),
        speed,
    });
    let faults = spawn_local(faults(Rc::clone(&world), branch()));
    let clients: Vec<_> =
        (0..CLIENTS).map(|number| spawn_local(live(Rc::clone(&world), number, branch()))).collect();
    let mut received = Received::default();
    let mut ended = faults.await.map_err(|error| format!("faults: {error}"))?;
    for (number, client) in clients.into_iter().enumerate() {
        let result = client.await.map_err(|error| error.to_string()).and_then(|result| result);
        match result {
            Ok(of_client) => received.add(&of_client),
            Err(error) => ended = ended.and(Err(format!("client {number}: {error}"))),
        }
    }
    // Another Err has a cause in this one.
    ended?;
    let at_rest = {
        let mut server = world.server.borrow_mut();
        let open = server.check()?;
        let jobs = server.state.metrics.generation.pending_jobs.get();
        let registered = server.state.open_sessions.count();
        (open, registered, jobs)
    };
    let expected = (CLIENTS as usize, CLIENTS as usize, 0);
    if at_rest != expected {
        return Err(format!("sessions, registered sessions and jobs at rest: {at_rest:?}, not {expected:?}"));
    }
    let World { server, .. } = Rc::into_inner(world).ok_or("a task is left")?;
    server.into_inner().kill().await;
    Ok(received)
}

fn started(plant: Plant, speed: &Rc<Speed>) -> Server {
    let speed = Rc::clone(speed);
    Server::start(plant, move || speed.next(plant))
}

/// One client until the end of the simulation: connects, acts, loses its connection, connects
/// again. Returns what it received.
async fn live(world: Rc<World>, number: u32, mut random: Random) -> Result<Received, String> {
    let mut client = Client::new(number, &mut random);
    sleep(Duration::from_millis(random.ms(0..300))).await;
    let (plant, end) = (world.plant, world.faults_end);
    let received = Received::default();
    let mut actions = Actions { random, plant, end, last: Last::View, received };
    let living = async {
        loop {
            let end = world.connect(number, &mut actions.random);
            client.connect(plant);
            drive(end, &mut client, &mut actions).await?;
            sleep(Duration::from_millis(client.lose())).await;
        }
    };
    let until: Result<Result<(), String>, _> = timeout_at(end + REST, living).await;
    until.unwrap_or(Ok(()))?;
    client.check_complete().map_err(|error| format!("at rest: {error}"))?;
    Ok(actions.received)
}

impl World {
    /// Connects a client, which has no other connection.
    fn connect(&self, client: u32, random: &mut Random) -> ClientEnd {
        let (link, end, far) = Link::new(random, self.plant);
        self.links.borrow_mut().insert(client, link);
        self.server.borrow_mut().serve(client, far);
        end
    }

    fn cut(&self, client: u32) {
        self.links.borrow_mut().remove(&client);
    }

    /// Replaces the server, and returns the old one.
    fn replaced(&self) -> Server {
        self.server.replace(started(self.plant, &self.speed))
    }
}

/// Random faults until their end.
async fn faults(world: Rc<World>, mut random: Random) -> Result<(), String> {
    sleep(Duration::from_millis(500)).await;
    while Instant::now() < world.faults_end {
        let until = Instant::now() + Duration::from_millis(random.ms(100..3000));
        let client = random.below(CLIENTS as usize) as u32;
        match random.below(10) {
            0 | 1 => world.cut(client),
            2 => stall(&world, client, until, true),
            3 => stall(&world, client, until, false),
            4 => world.speed.slow_until.set(until),
            5 => world.speed.failing_until.set(until),
            6 => {
                let old = world.replaced();
                (0..CLIENTS).for_each(|client| world.cut(client));
                old.kill().await;
            }
            7 => world.replaced().drain().await?,
            8 => {
                if let Some(link) = world.links.borrow().get(&client) {
                    link.up.sliced_until.set(until);
                    link.down.sliced_until.set(until);
                }
            }
            _ => {
                let link = world.links.borrow_mut().remove(&client);
                world.silent.borrow_mut().extend(link.inspect(Link::fall_silent));
            }
        }
        world.server.borrow_mut().check()?;
        sleep(Duration::from_millis(random.ms(100..1500))).await;
    }
    sleep_until(world.faults_end + REST).await;
    Ok(())
}

fn stall(world: &World, client: u32, until: Instant, is_up: bool) {
    if let Some(link) = world.links.borrow().get(&client) {
        let direction = if is_up { &link.up } else { &link.down };
        direction.stalled_until.set(until);
    }
}
