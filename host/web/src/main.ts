/// The page begins: the graph at /, the surgeon's picture at /video.
import { mount } from 'svelte';
import './app.css';
import App from './App.svelte';
import Video from './Video.svelte';

const target = document.getElementById('app')!;
mount(location.pathname === '/video' ? Video : App, { target });
