// Start of the page. A replay contains its data; a live page receives its data with the first event "begin", and compiles
// its shaders while the simulation builds the arm.
import './style.css';
import { given } from './given.js';
import { Stage } from './scene.js';

const $ = id => document.getElementById(id), embedded = JSON.parse($('data').textContent);

const begin = data => {
  given.data = data;
  import('./main.js');
};

try {
  given.stage = new Stage($('gl'), embedded.live);
} catch (error) {
  $('sorry').hidden = false;
}
if (embedded.live) {
  $('note').textContent = 'the arm is being built';
  given.source = new EventSource('live');
  given.source.addEventListener('begin', event => {
    $('note').textContent = '';
    begin(JSON.parse(event.data));
  }, { once: true });
  given.source.onerror = () => { $('note').textContent = 'the simulation is closed, or this page lost it'; };
  given.stage?.compile();
} else begin(embedded);
