//! What the links by sACN say of themselves, so that consoles list them: which universes a source sends, every 10 seconds.

use facewire_packet::formats::dmx::{DISCOVERY_PERIOD, cid, discovery};

use crate::config::{LinkKind, LinkSettings, SacnSettings};

const PERIOD_US: u64 = DISCOVERY_PERIOD.as_micros() as u64;

/// A datagram about a source, and when it is due.
pub struct Announcement {
    message: Vec<u8>,
    due_us: u64,
}

impl Announcement {
    /// Returns the datagram if it is due at `now_us`.
    pub fn due(&mut self, now_us: u64) -> Option<&[u8]> {
        if now_us < self.due_us {
            return None;
        }
        self.due_us = now_us.saturating_add(PERIOD_US);
        Some(&self.message)
    }
}

/// The identifier of the source of this link. It does not give away that of the machine.
pub fn cid_of(it: &SacnSettings) -> [u8; 16] {
    cid(&[&facewire_board::machine_id(), &it.source])
}

/// Returns what the link of this number announces. A source can send several universes, each by a link of its own: the first of
/// its links to a receiver names all of them, because consoles keep the last list that a source has sent.
pub fn announcement(links: &[LinkSettings], number: usize) -> Option<Announcement> {
    let it = sacn(links.get(number)?)?;
    let mut universes = Vec::new();
    for (index, link) in links.iter().enumerate() {
        let Some(other) = sacn(link).filter(|other| (&it.source, &it.address) == (&other.source, &other.address))
        else {
            continue;
        };
        if index < number {
            return None;
        }
        let universe = other.universe as u16;
        let place = universes.iter().position(|known| *known > universe).unwrap_or(universes.len());
        universes.insert(place, universe);
    }
    Some(Announcement { message: discovery(cid_of(it), &it.source, &universes), due_us: 0 })
}

fn sacn(link: &LinkSettings) -> Option<&SacnSettings> {
    if let LinkKind::Sacn(it) = &link.kind { Some(it) } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::parse;

    const UNIVERSE_3: &str = "[[link]]\nkind = \"sacn\"\nuniverse = 3\n";

    /// The universes that each link announces, and how often it does within a minute, asked every 25 ms.
    fn announced(text: &str) -> Vec<Option<(Vec<u8>, usize)>> {
        let links = parse("test", text).unwrap().links;
        let announced = (0..links.len()).map(|number| announcement(&links, number));
        let of_minute = |mut it: Announcement| (0..2400).filter(|step| it.due(step * 25_000).is_some()).count();
        let universes = |it: &Announcement| it.message[120..].iter().copied().skip(1).step_by(2).collect();
        announced.map(|it| it.map(|it| (universes(&it), of_minute(it)))).collect()
    }

    #[test]
    fn the_first_link_of_a_source_to_a_receiver_announces_all_of_its_universes_in_their_order_every_ten_seconds() {
        let link = |keys: &str| format!("[[link]]\nkind = \"sacn\"\n{keys}\n");
        let text = [
            UNIVERSE_3.to_owned(),
            "[[link]]\nkind = \"artnet\"\n".to_owned(),
            link("universe = 1"),
            link("universe = 2\naddress = \"10.0.0.1:5568\""),
            link("universe = 4\nsource = \"other\""),
        ];
        let want = [Some((vec![1, 3], 6)), None, None, Some((vec![2], 6)), Some((vec![4], 6))];
        assert_eq!(announced(&text.concat()), want);
    }
}
