//! Places for connections.
//!
//! Whoever has shown no right to anything makes room for new connections, then whoever may only look, and at last operators, so
//! that many slow clients, or somebody with a stolen link to look, cannot keep an operator from letting go of the servos.

use std::{
    collections::VecDeque,
    net::IpAddr,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

use tokio::sync::Notify;

use crate::access::{Role, network};

/// The open connections, the oldest first.
#[derive(Debug, Default, Clone)]
pub struct Places(Arc<Mutex<VecDeque<Arc<Connection>>>>);

#[derive(Debug)]
struct Connection {
    /// Where it comes from.
    network: IpAddr,
    standing: Mutex<Standing>,
    end: Notify,
}

/// The claim of a connection to its place, after the last request that came over it.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Standing {
    pub role: Option<Role>,
    /// Whether the request must not be cut off: a release, a login that is being judged, or the stream of an open page.
    pub is_urgent: bool,
}

/// The place of one connection, until it is dropped.
#[derive(Debug)]
pub struct Place(Arc<Connection>, Places);

impl Places {
    fn open(&self) -> MutexGuard<'_, VecDeque<Arc<Connection>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a place. If `most` are taken, a connection of the least standing loses its own: the oldest one from the network that
    /// has most connections, so that a flood from one network cuts off itself.
    pub fn enter(&self, most: usize, client: IpAddr) -> Place {
        let mut open = self.open();
        if open.len() >= most
            && let Some(connection) = least(&open).and_then(|place| open.remove(place))
        {
            connection.end.notify_one();
        }
        let network = network(client.to_canonical());
        let connection = Arc::new(Connection { network, standing: Mutex::default(), end: Notify::new() });
        open.push_back(Arc::clone(&connection));
        Place(connection, self.clone())
    }
}

/// Returns the place that is given up first.
fn least(open: &VecDeque<Arc<Connection>>) -> Option<usize> {
    let least = open.iter().map(|connection| connection.standing()).min()?;
    let count = |network: IpAddr| open.iter().filter(|connection| connection.network == network).count();
    let losers = open.iter().enumerate().filter(|(_, connection)| connection.standing() == least);
    // Of several, the last one is the greatest.
    losers.rev().max_by_key(|(_, connection)| count(connection.network)).map(|(place, _)| place)
}

impl Connection {
    fn standing(&self) -> Standing {
        *self.standing.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Place {
    /// Records the standing that a request gives the connection.
    pub fn set(&self, standing: Standing) {
        *self.0.standing.lock().unwrap_or_else(PoisonError::into_inner) = standing;
    }

    /// Waits until the connection must make room for another one.
    pub async fn lost(&self) {
        self.0.end.notified().await;
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        self.1.open().retain(|connection| !Arc::ptr_eq(connection, &self.0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn is_open(place: &Place) -> bool {
        place.1.open().iter().any(|connection| Arc::ptr_eq(connection, &place.0))
    }

    #[test]
    fn a_flood_from_one_network_cuts_off_itself() {
        let places = Places::default();
        let [owner, guest, neighbour] =
            ["192.168.1.5", "2001:db8::1", "2001:db8::2"].map(|address| address.parse().unwrap());
        let owner = places.enter(4, owner);
        let first = places.enter(4, guest);
        let flood: Vec<_> = (0..50).map(|_| [places.enter(4, guest), places.enter(4, neighbour)]).collect();
        assert!(is_open(&owner) && !is_open(&first));
        assert_eq!(flood.iter().flatten().filter(|place| is_open(place)).count(), 3);
    }

    #[test]
    fn the_oldest_of_the_least_standing_makes_room() {
        let places = Places::default();
        let enter = || places.enter(4, [192, 168, 1, 5].into());
        let of = |role, is_urgent| {
            let place = enter();
            place.set(Standing { role, is_urgent });
            place
        };
        let stop = of(Some(Role::Operate), true);
        let operators = [(); 2].map(|()| of(Some(Role::Operate), false));
        let looker = of(Some(Role::Look), true);
        let stranger = enter();
        assert!(!is_open(&looker) && is_open(&stranger) && operators.iter().all(is_open));
        let third = of(Some(Role::Operate), false);
        assert!(!is_open(&stranger) && operators.iter().all(is_open));
        let fourth = of(Some(Role::Operate), false);
        assert_eq!(
            [&operators[0], &operators[1], &third, &fourth, &stop].map(is_open),
            [false, true, true, true, true]
        );
    }
}
